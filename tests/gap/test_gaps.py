"""A gap in a recording breaks a run: nothing is predicted across it, and no command is held across it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig, Run, diagnose, load_case
from realsim.gap.case.runs import find_gaps, usual_step
from realsim.gap.pipeline import limited
from realsim.gap.recordings import load_target, propose
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.recording import Field, Recording, Stream
from tests.gap.recordings.robots import ARM, drive, save

from .truth import Truth

GAPS = ((1.2, 1.36), (2.3, 2.46))


@pytest.fixture(scope="module")
def good(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(motor_gain={"elbow": 0.75})))


def with_gaps(run: Run) -> Run:
    keep = np.ones(len(run.time), bool)
    for begin, end in GAPS:
        keep &= (run.time < begin) | (run.time > end)
    return run.where(keep)


def test_stretches_hold_all_samples_and_begin_at_zero(good: Case) -> None:
    run = with_gaps(good.runs[0])
    parts = run.stretches(0.5)
    assert [p.goes_on for p in parts] == [False, True, True]
    np.testing.assert_array_equal(np.concatenate([p.command for p in parts]), run.command)
    assert all(p.time[0] == 0 and np.diff(p.time).max() < 0.05 for p in parts)
    assert good.runs[0].stretches(0.5) == [good.runs[0]]


def test_short_stretches_are_left_out_and_the_note_says_how_much_is_used(good: Case) -> None:
    run = good.runs[0].where(~((good.runs[0].time > 1.2) & (good.runs[0].time < 1.4)))
    run = run.where(~((run.time > 1.6) & (run.time < 1.8)))
    case = limited(good.with_runs((run,)), DiagnoseConfig())
    assert len(case.runs) == 2
    notes = [w for w in case.warnings if "gaps in time" in w]
    assert len(notes) == 1
    assert "2 gaps in time in 1 runs, the longest 0.2" in notes[0]


@pytest.mark.parametrize(
    ("stamps", "usual", "gaps"),
    [
        (np.arange(400) * 0.01, 0.01, 0),
        (np.repeat(np.arange(40) * 0.064, 10) + np.tile(np.arange(10) * 1e-4, 40), 0.0631, 0),  # a bus in bursts
        (np.concatenate([np.arange(200) * 0.01, 60 + np.arange(200) * 0.01]), 0.01, 1),  # a pause longer than the log
        (np.cumsum(np.where(np.arange(300) % 100 == 99, 0.16, 0.01)), 0.01, 3),
        (np.cumsum(np.where(np.arange(300) % 20 == 19, 0.02, 0.01)), 0.01, 0),  # single rows that were lost
    ],
)
def test_gaps_are_steps_far_above_the_usual_one(stamps: Any, usual: float, gaps: int) -> None:
    assert usual_step(stamps) == pytest.approx(usual)
    assert len(find_gaps(stamps)) == gaps


@pytest.mark.slow
def test_a_cause_is_found_beside_gaps(good: Case) -> None:
    case = good.with_runs(tuple(with_gaps(r) for r in good.runs[:2]))
    library = ("motor_gain", "coulomb_friction", "viscous_friction", "payload", "command_delay")
    found = diagnose(case, DiagnoseConfig(threads=1, effects=library, report=False))
    assert found.verdict == "identified"
    assert [c["effect"] for c in found.causes] == ["motor_gain"]
    low, high = found.causes[0]["parameters"]["ratio"]["ci90"]
    assert low < 0.75 < high


def test_repeated_stamps_leave_the_newest_sample(good: Case, tmp_path: Path) -> None:
    run = good.runs[0]
    folder = tmp_path / "case"
    (folder / "runs").mkdir(parents=True)
    for name in ("model.xml", "log.json"):
        (folder / name).write_text((good.folder / name).read_text())
    twice = np.repeat(run.time[1::2], 2)
    rows = slice(0, len(twice))
    np.savez(folder / "runs" / "a.npz", time=twice, command=run.command[rows], joint_pos=run.signals["joint_pos"][rows])
    read = load_case(folder).runs[0]
    np.testing.assert_allclose(read.signals["joint_pos"], run.signals["joint_pos"][1 : len(twice) : 2])
    assert any("time stamps repeat" in w for w in load_case(folder).warnings)


# ---------------------------------------------------------------- recordings of streams


def rows_of(tmp_path: Path, sent: Any, places: Any) -> tuple[Any, Any]:
    """(times of the rows, notes) where these moments of commands and positions were recorded."""
    log = drive(ARM)
    names = ("shoulder_joint", "elbow_joint")
    streams = [
        Stream("cmd", "table", {"time": log.time[sent]}, {"position_command": Field(log.command[sent], names)}),
        Stream("state", "table", {"time": log.time[places]}, {"position": Field(log.pos[places], names)}),
    ]
    recording = Recording(Path("log"), "run", "test", tuple(streams))
    found = run_arrays(propose([recording], load_target(save(tmp_path, ARM))), recording)
    return found.arrays["time"] + found.span[0], found.notes


def test_rows_whose_command_was_not_recorded_are_left_out(tmp_path: Path) -> None:
    time = drive(ARM).time
    rows, notes = rows_of(tmp_path, (time < 1.5) | (time > 1.8), time >= 0)
    assert not ((rows > 1.55) & (rows < 1.78)).any()
    assert any("commands were not recorded" in n for n in notes)
    rows, _ = rows_of(tmp_path, time < 3.0, time >= 0)  # commands end before states
    assert rows[-1] < 3.2


def test_commands_are_kept_where_positions_were_lost(tmp_path: Path) -> None:
    time = drive(ARM).time
    rows, _ = rows_of(tmp_path, time >= 0, (time < 1.5) | (time > 1.8))
    assert not find_gaps(rows)


def test_a_single_goal_holds(tmp_path: Path) -> None:
    time = drive(ARM).time
    rows, _ = rows_of(tmp_path, np.arange(len(time)) % 80 == 0, time >= 0)
    assert not find_gaps(rows)
