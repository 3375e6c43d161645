"""A clock that jumps is found, said, and ends a run; messages that wait do not."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.errors import GapError
from realsim.gap.recordings import Recording, Window, load_target, propose, read, write_case
from realsim.gap.recordings.clocks import clocked
from realsim.gap.recordings.jumps import unbroken
from realsim.gap.recordings.recording import Field, Stream

from . import writers
from .robots import ARM, Log, save

JOINTS = ["shoulder_joint", "elbow_joint"]


def _recording(true: np.ndarray, state: dict[str, np.ndarray], sent: np.ndarray) -> Recording:
    """Joint states with stamps, commands without; their values are the true times."""
    fields = {"q": Field(true[:, None])}
    streams = (Stream("/state", "x", state, fields), Stream("/command", "y", {"receive": sent}, fields))
    return Recording(Path("a.mcap"), "a", "mcap", streams)


def _received(true: np.ndarray, seed: int = 0) -> np.ndarray:
    """One after the other, as they are written."""
    return np.maximum.accumulate(true + 0.003 + np.random.default_rng(seed).exponential(0.002, len(true)))


sizes = st.one_of(st.floats(0.15, 4000.0), st.floats(-4000.0, -0.15))


@settings(max_examples=60, deadline=None)
@given(by=sizes, at=st.floats(1.5, 4.5), rate=st.sampled_from([50, 200, 500]), seed=st.integers(0, 99))
def test_each_stretch_keeps_its_own_time(by: float, at: float, rate: int, seed: int) -> None:
    true = np.arange(6 * rate) / rate + 1.7e9
    received = _received(true, seed)
    jumped = received + np.where(received > 1.7e9 + at, by, 0.0)
    sent = true + np.where(true > 1.7e9 + at, by, 0.0)
    parts = unbroken(_recording(true, {"receive": jumped, "header": true}, sent))
    assert len(parts) == 2
    assert "the clock of reception jumps" in parts[0].notes[0]
    for part in parts:
        times = clocked(part)
        lag = times["/state"].time.min() - part.streams[0].fields["q"].values.min()
        for stream in part.streams:
            np.testing.assert_allclose(times[stream.name].time - stream.fields["q"].values[:, 0], lag, atol=0.02)
    assert sum(p.streams[0].count for p in parts) == len(true)


@settings(max_examples=40, deadline=None)
@given(seconds=st.floats(0.2, 4.0), at=st.floats(1.5, 4.5), rate=st.sampled_from([50, 200, 500]))
def test_messages_that_wait_are_no_jump(seconds: float, at: float, rate: int) -> None:
    true = np.arange(10 * rate) / rate
    received = _received(true)
    stall = (true > at) & (true < at + seconds)
    received = np.maximum.accumulate(np.where(stall, at + seconds, received))
    state = {"receive": received, "header": true}
    assert len(unbroken(_recording(true, state, true))) == 1


def test_a_stamp_that_is_off_is_left_out(arm: Log) -> None:
    header = arm.time.copy()
    header[300] += 5.0
    (part,) = unbroken(_recording(arm.time, {"receive": _received(arm.time), "header": header}, arm.time))
    time = clocked(part)["/state"].time
    assert np.flatnonzero(np.isnan(time)).tolist() == [300]
    np.testing.assert_array_equal(np.delete(time, 300), np.delete(arm.time, 300))


def test_a_stamp_that_jumps_is_not_used(arm: Log) -> None:
    header = arm.time + np.where(arm.time > 2.0, 0.4, 0.0)
    (part,) = unbroken(_recording(arm.time, {"receive": _received(arm.time), "header": header}, arm.time))
    found = clocked(part)["/state"]
    assert found.clock == "receive"
    assert "jumps" in found.warnings[0]


def test_a_table_that_begins_anew_is_two_runs(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    np.savez(tmp_path / "run.npz", time=arm.time % 2.0, joint_pos=arm.pos, command=arm.command)
    proposal = propose(read(tmp_path / "run.npz"), target)
    assert [r.name for r in proposal.recordings] == ["run_1", "run_2"]
    write_case(proposal, target, tmp_path / "case")


def test_a_clock_that_jumps_all_the_time_is_refused() -> None:
    time = np.arange(40_000) * 0.01 % 0.5
    with pytest.raises(GapError, match=r"jumps or pauses \d+ times"):
        unbroken(_recording(time, {"header": time}, time))


@pytest.mark.parametrize("version", [1, 2])
def test_a_bag_that_mixes_two_stretches_is_refused(version: int, arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install -e '.[logs]'")
    back = Log(arm.time - np.where(arm.time > 2.0, 1.0, 0.0), arm.command, arm.pos, arm.vel, arm.torque)
    path = writers.bag(tmp_path / ("run.bag" if version == 1 else "run"), back, JOINTS, version)
    with pytest.raises(GapError, match=r"steps back by 0.99[\s\S]*--seconds 1.00[\s\S]*--skip 2.0"):
        read(path)
    for window in (Window(0.0, 0.9), Window(2.1)):
        assert read(path, window)[0].streams[0].count > 100


def test_a_folder_of_mcap_is_read_like_its_files(arm: Log, tmp_path: Path) -> None:
    messages: Any = writers.joint_states(arm, JOINTS) + writers.float_commands(arm)
    file = writers.mcap_ros2(tmp_path / "run.mcap", sorted(messages, key=lambda m: m[3]))
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}\n")
    (bag / "bag_0.mcap").write_bytes(file.read_bytes()[: file.stat().st_size // 2])  # killed while it recorded
    (found,) = read(bag)
    assert found.reader == "mcap"
    assert 0 < found.streams[0].count < len(arm.time)
    assert any("cut off" in n for n in found.notes)


def test_files_of_a_bag_are_read_as_they_were_recorded(arm: Log, tmp_path: Path) -> None:
    messages: Any = sorted(writers.joint_states(arm, JOINTS) + writers.float_commands(arm), key=lambda m: m[3])
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}\n")
    for k in range(12):
        writers.mcap_ros2(tmp_path / f"bag_{k}.mcap", messages[k * 170 : (k + 1) * 170])
    (found,) = read(tmp_path)
    assert sum(s.count for s in found.streams) == len(messages[: 12 * 170])


def test_a_topic_that_ends_before_a_jump_is_in_one_run(arm: Log, tmp_path: Path) -> None:
    states: Any = writers.joint_states(arm, JOINTS)
    messages = sorted(states + writers.float_commands(arm)[:200], key=lambda m: m[3])
    back = [(*m[:3], m[3] - (2.0 if m[3] > writers.EPOCH + 2.0 else 0.0), m[4]) for m in messages]
    found = read(writers.mcap_ros2(tmp_path / "run.mcap", back))
    assert [len(r.streams) for r in found] == [2, 1]
    target = load_target(save(tmp_path, ARM))
    write_case(propose(found, target), target, tmp_path / "case")


@pytest.mark.parametrize(("name", "unit"), [("time_us", 1e6), ("tick", 1e3)])
def test_a_gap_of_ten_samples_is_no_pause_in_any_unit(name: str, unit: float, arm: Log) -> None:
    late = arm.time + np.where(arm.time > 2.0, 0.06, 0.0)
    stream = Stream("", "table", {name: late * unit}, {"q": Field(arm.pos)})
    (whole,) = unbroken(Recording(Path("a.csv"), "a", "csv", (stream,)))
    assert not whole.notes
    stream = Stream("", "table", {name: (arm.time % 2.0) * unit}, {"q": Field(arm.pos)})
    assert len(unbroken(Recording(Path("a.csv"), "a", "csv", (stream,)))) == 2


def test_a_counter_that_wraps_is_no_clock_where_there_is_another(arm: Log) -> None:
    clocks = {"tick": np.arange(len(arm.time)) % 256 * 1.0, "time": arm.time}
    stream = Stream("", "table", clocks, {"q": Field(arm.pos)})
    (whole,) = unbroken(Recording(Path("a.csv"), "a", "csv", (stream,)))
    np.testing.assert_array_equal(clocked(whole)[""].time, arm.time)
