"""Bad input ends in a message that names the file, and leaves nothing behind."""

import contextlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.bags import mcap_records
from realsim.core.errors import GapError, RealsimError
from realsim.gap import load_case
from realsim.gap.case.units import travelled
from realsim.gap.recordings import Window, load_target, propose, read, write_case
from realsim.gap.recordings.signals import follows

from . import writers
from .robots import ARM, Log, save

JOINTS = ["shoulder_joint", "elbow_joint"]


@pytest.fixture
def mcap(arm: Log, tmp_path: Path) -> Path:
    messages = writers.joint_states(arm, JOINTS) + writers.float_commands(arm)
    return writers.mcap_ros2(tmp_path / "run.mcap", sorted(messages, key=lambda m: m[3]))


def test_a_file_that_is_cut_off_is_read_as_far_as_it_goes(mcap: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.mcap"
    short.write_bytes(mcap.read_bytes()[: int(0.7 * mcap.stat().st_size)])
    whole, (part,) = read(mcap)[0].streams[0].count, read(short)
    assert 0 < part.streams[0].count < whole
    assert any("cut off" in n for n in part.notes)
    for length in range(2 * mcap.stat().st_size // 5, mcap.stat().st_size, mcap.stat().st_size // 23):
        short.write_bytes(mcap.read_bytes()[:length])
        notes: list[str] = []
        list(mcap_records(short, notes))
        assert notes, length


def test_settings_beside_folders_of_runs_hide_no_run(tmp_path: Path) -> None:
    (tmp_path / "columns.json").write_text('{"time": "stamp"}')
    with pytest.raises(GapError, match="no samples"):
        read(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "one.csv").write_text("time,angle\n" + "".join(f"{0.01 * k},{k % 7}\n" for k in range(200)))
    (run,) = read(tmp_path)
    assert run.streams[0].count == 200
    assert any("columns.json" in note for note in run.notes)


@pytest.mark.parametrize(
    "name", ["a.mcap", "a.bag", "a.db3", "a.parquet", "a.ulg", "a.npz", "a.csv", "a.jsonl", "a.pt"]
)
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 64, b"\x89MCAP0\r\n" + bytes(range(256)) * 8], ids=["empty", "zeros", "noise"]
)
def test_damaged_files_of_every_kind(name: str, content: bytes, tmp_path: Path) -> None:
    for package in ("mcap", "rosbags", "pyarrow", "pyulog"):
        pytest.importorskip(package, reason=f"{package} is not installed: pip install -e '.[logs]'")
    if name.endswith(".pt"):
        pytest.importorskip("torch", reason="torch is not installed: pip install -e '.[train]'")
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RealsimError) as error:
        read(path)
    assert str(path) in str(error.value)


def test_damage_anywhere_is_no_traceback(mcap: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    data = bytearray(mcap.read_bytes())
    for trial in range(6):
        spoiled = data.copy()
        for at in rng.integers(0, len(spoiled), 5):
            spoiled[at] ^= 0xFF
        path = tmp_path / f"{trial}.mcap"
        path.write_bytes(spoiled)
        with contextlib.suppress(RealsimError):
            propose(read(path))


def test_unknown_definitions_and_topics_are_listed(arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed: pip install -e '.[dev]'")
    from mcap.writer import Writer

    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        odd = writer.register_schema("my_pkg/msg/Odd", "ros2msg", b"this is % no definition")
        proto = writer.register_schema("Pose", "protobuf", b"\1\2")
        for topic, schema, encoding in (("/odd", odd, "cdr"), ("/pose", proto, "protobuf"), ("/raw", 0, "x")):
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, log_time=1, publish_time=1, data=b"1234")
        writer.finish()
    with pytest.raises(GapError, match="no samples") as error:
        read(path)
    for text in ("/odd", "/pose", "/raw", "cannot be decoded", "protobuf"):
        assert text in str(error.value)


def test_messages_of_a_strange_type_are_read(arm: Log, tmp_path: Path) -> None:
    messages = [
        ("/wheels", "my_pkg/msg/Wheels", writers.STRANGE, writers.EPOCH + t,
         {"header": writers.header(writers.EPOCH + t), "wheels": [{"speed": 1.0}, {"speed": 2.0}]})
        for t in arm.time[:50]
    ]  # fmt: skip
    (recording,) = read(writers.mcap_ros2(tmp_path / "strange.mcap", messages))
    np.testing.assert_array_equal(recording.streams[0].fields["wheels.speed"].values[0], [1.0, 2.0])


def test_an_hour_of_nothing_ends_a_run(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    late = np.where(np.arange(len(arm.time)) > 100, 3700.0, 0.0)
    np.savez(tmp_path / "run.npz", time=arm.time + late, joint_pos=arm.pos, command=arm.command)
    proposal = propose(read(tmp_path / "run.npz"), target)
    assert any("jumps ahead, or recording paused (+3.7e+03 s)" in w for w in proposal.warnings)
    write_case(proposal, target, tmp_path / "case", check=load_case)
    assert [len(r.time) for r in load_case(tmp_path / "case").runs] == [101, len(arm.time) - 101]


def test_a_case_without_a_command_is_never_written(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    np.savez(tmp_path / "run.npz", time=arm.time, q=arm.pos)
    proposal = propose(read(tmp_path / "run.npz"), target)
    with pytest.raises(GapError, match=r"not complete[\s\S]*recorded: "):
        write_case(proposal, target, tmp_path / "case")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["robot.xml", "run.npz"]


def test_command_line(arm: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = save(tmp_path, ARM)
    np.savez(tmp_path / "run.npz", time=arm.time, q=arm.pos, q_des=arm.command)
    run = str(tmp_path / "run.npz")
    assert main(["log", run, "--model", str(model), "--out", str(tmp_path / "case")]) == 0
    assert "joint_pos" in capsys.readouterr().out
    assert (tmp_path / "case" / "proposal.json").is_file()
    assert main(["log", run, "--model", str(model), "--out", str(tmp_path / "case")]) == 2  # not without --overwrite
    assert main(["log", run, "--model", str(model), "--out", str(tmp_path / "case"), "--overwrite"]) == 0
    capsys.readouterr()
    assert main(["log", run, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["arrays"]["joint_pos"]["field"] == "q"
    for arguments in (
        ["log", str(tmp_path / "nothing")],
        ["log", str(model)],
        ["log", run, "--out", str(tmp_path / "x")],
    ):
        assert main(arguments) == 2
    assert main(["log", run, "--model", run]) == 2


def test_lists_of_different_lengths_and_broken_rows(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('time,q\n0,"[1, 2]"\n1,"[1, 2, 3]"\n')
    with pytest.raises(GapError, match="different lengths"):
        read(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("time,q\n0,1\n1,1,2\n")
    with pytest.raises(GapError, match="wrong number of cells"):
        read(tmp_path / "b.csv")


def test_a_cell_that_is_no_number_is_said(tmp_path: Path) -> None:
    rows = "".join(f'{t},"[{t}, 0.5]",{t}\n' for t in range(30))
    path = tmp_path / "a.csv"
    path.write_text("time,target,q\n" + rows)
    assert not read(path)[0].notes
    path.write_text("time,target,q\n" + rows.replace('"[7, 0.5]"', '"[7, 0x10]"').replace(",8\n", ",\n"))
    assert read(path)[0].notes == ("a.csv: target has values that are no numbers, the first is '[7, 0x10]'",)
    path.write_text("time,target,q\n" + rows.replace(",8\n", ",inf\n"))
    (run,) = read(path)
    assert run.notes == ("a.csv: 1 infinite values of q are taken as missing",)
    assert not np.isinf(run.streams[0].fields["q"].values).any()


def test_a_column_without_a_name_is_an_index(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(",time,q\n" + "".join(f"{t},{0.01 * t},1.5\n" for t in range(30)))
    (run,) = read(tmp_path / "a.csv")
    assert list(run.streams[0].fields) == ["q"]


def test_an_empty_folder_and_prose_are_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(GapError, match=r"no recording|no samples"):
        read(tmp_path)
    (tmp_path / "notes.txt").write_text(
        "It was recorded on a Tuesday, with the light on and the windows open, and then we went\n"
    )
    with pytest.raises(GapError, match=r"no recording|no samples"):
        read(tmp_path)


def test_a_pipe_in_a_folder_of_recordings_is_refused(arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install -e '.[logs]'")
    folder = writers.lerobot(tmp_path / "set", [arm], JOINTS)
    (file,) = (folder / "data").rglob("*.parquet")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(RealsimError, match="not a plain file"):
        read(folder)


def test_a_run_named_by_bytes_that_are_no_text_is_written(arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    path = tmp_path / os.fsdecode(b"run\xff.npz")
    np.savez(path, time=arm.time, q=arm.pos, q_des=arm.command)
    write_case(propose(read(path), target), target, str(tmp_path / "case"))
    assert len(load_case(tmp_path / "case").runs) == 1


@pytest.mark.parametrize(("old", "new"), [('damping="0.3"', 'damping="nan"'), ('mass="2.5"', 'mass="1e30"')])
def test_a_model_that_cannot_be_simulated_is_refused(old: str, new: str, tmp_path: Path) -> None:
    assert old in ARM
    with pytest.raises(GapError, match="cannot be simulated"):
        load_target(save(tmp_path, ARM.replace(old, new)))


def test_no_clock_and_no_values_are_no_traceback() -> None:
    one = np.zeros(1)
    assert not len(travelled(one, one, one)[0])


def test_a_number_of_hundreds_of_digits_is_no_traceback(tmp_path: Path) -> None:
    rows = [{"time": 0.01 * i, "q": 10**400 if i == 3 else 0.1, "r": [0.1, 10**400]} for i in range(30)]
    (tmp_path / "a.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    with contextlib.suppress(RealsimError):
        propose(read(tmp_path / "a.jsonl"))


@pytest.mark.parametrize("rows", [1, 2, 21])
def test_hardly_any_samples_are_no_traceback(rows: int, arm: Log, tmp_path: Path) -> None:
    target = load_target(save(tmp_path, ARM))
    few = {"time": arm.time[:rows], "q": arm.pos[:rows], "q_des": arm.command[:rows]}
    (tmp_path / "a.jsonl").write_text(
        "".join(json.dumps({k: np.asarray(v[i]).tolist() for k, v in few.items()}) + "\n" for i in range(rows))
    )
    with contextlib.suppress(RealsimError):
        propose(read(tmp_path / "a.jsonl"), target)
    with contextlib.suppress(RealsimError):
        follows(arm.time[:rows], arm.command[:rows, 0], arm.pos[:rows, 0])


@pytest.mark.parametrize("name", ["a.csv", "a.jsonl", "a.rrd"])
def test_an_empty_file_says_so(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(GapError, match="the file is empty"):
        read(tmp_path / name)


def test_one_damaged_file_of_a_folder_stops_no_other(arm: Log, tmp_path: Path) -> None:
    np.savez(tmp_path / "good.npz", time=arm.time, q=arm.pos, q_des=arm.command)
    (tmp_path / "bad.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:500])
    (tmp_path / "none.csv").touch()
    (run,) = read(tmp_path)
    assert run.name == "good"
    assert "none.csv: the file is empty" in run.notes
    assert any(n.startswith("bad.npz: ") for n in run.notes)


def test_a_table_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    rows = "".join(f'{t},"[{t}, 0.5]",{t}\n' for t in range(30))
    path = tmp_path / "a.csv"
    path.write_text("time,target,q\n" + rows + '30,"[30, 0.')
    (run,) = read(path)
    assert run.streams[0].count == 30
    assert run.notes == ("a.csv: the last row is cut off: it is left out",)


def test_a_ulog_that_is_cut_off_is_said_to_be(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed: pip install -e '.[logs]'")
    path = writers.ulog(tmp_path / "a.ulg", np.arange(50) * 0.01, "sensor_combined", {"gyro_rad[0]": np.zeros(50)})
    assert not read(path)[0].notes
    path.write_bytes(path.read_bytes()[:-5])
    (run,) = read(path)
    assert run.streams[0].count == 49
    assert run.notes == ("a.ulg is damaged: read as far as it goes",)


def test_a_window_beyond_the_end_says_so(arm: Log, mcap: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install -e '.[logs]'")
    np.savez(tmp_path / "run.npz", time=arm.time, q=arm.pos)
    for path in (mcap, tmp_path / "run.npz", writers.lerobot(tmp_path / "set", [arm], JOINTS)):
        with pytest.raises(GapError, match="--skip"):
            read(path, Window(100.0))


def test_a_short_episode_is_left_out_of_a_window(arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install -e '.[logs]'")
    short = Log(arm.time[:100], arm.command[:100], arm.pos[:100], arm.vel[:100], arm.torque[:100])
    source = writers.lerobot(tmp_path / "set", [arm, short], JOINTS)
    assert [r.name for r in read(source, Window(1.0))] == ["episode_000000"]


def test_diagnose_of_a_recording(arm: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = save(tmp_path, ARM)
    np.savez(tmp_path / "run.npz", time=arm.time, q=arm.pos, q_des=arm.command)
    run = str(tmp_path / "run.npz")
    assert main(["diagnose", run, "--model", str(model), "--check"]) == 0
    assert "can be used" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["robot.xml", "run.npz"]
    for command in ("diagnose", "excite"):
        assert main([command, run]) == 2
        assert "--model robot.xml" in capsys.readouterr().err
