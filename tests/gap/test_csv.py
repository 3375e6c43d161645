"""CSV runs say the same as npz runs, in any units, and damage is named with the closest names."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.core.errors import RealsimError
from realsim.gap import load_case

from .truth import Truth

MAP = {
    "time": {"column": "stamp", "unit": "us"},
    "command": {"columns": ["s_des", "e_des"], "unit": "deg"},
    "joint_pos": ["s_pos", {"column": "e_pos", "unit": "deg", "sign": -1}],
    "joint_vel": {"columns": ["s_vel", "e_vel"], "unit": "rpm"},
}


@pytest.fixture
def case(made: Callable[..., Path], tmp_path: Path) -> Path:
    """The plain case with its runs as CSV files of other units, names and signs."""
    folder = tmp_path / "case"
    shutil.copytree(made(Truth()), folder)
    for path in sorted((folder / "runs").glob("*.npz")):
        with np.load(path) as data:
            deg = np.degrees
            table = {
                "stamp": 1e6 * (data["time"] + 1.7e9),
                "s_des": deg(data["command"][:, 0]),
                "e_des": deg(data["command"][:, 1]),
                "s_pos": data["joint_pos"][:, 0],
                "e_pos": -deg(data["joint_pos"][:, 1]),
                "s_vel": data["joint_vel"][:, 0] * 30 / np.pi,
                "e_vel": data["joint_vel"][:, 1] * 30 / np.pi,
            }
        write(path.with_suffix(".csv"), table)
        path.unlink()
    (folder / "columns.json").write_text(json.dumps(MAP))
    return folder


def write(path: Path, table: dict[str, Any], delimiter: str = ",") -> None:
    rows = [delimiter.join([*table, "mode"])]
    for values in zip(*table.values(), strict=True):
        cells = ["" if np.isnan(v) else repr(float(v)) for v in values]
        rows.append(delimiter.join([*cells, "walk"]))
    path.write_text("\ufeff" + "\n".join(rows) + "\n")


def remap(folder: Path, **changes: Any) -> None:
    (folder / "columns.json").write_text(json.dumps({k: v for k, v in (MAP | changes).items() if v is not None}))


def edit(folder: Path, change: Callable[[list[str]], list[str]]) -> None:
    for path in (folder / "runs").glob("*.csv"):
        path.write_text("\n".join(change(path.read_text(encoding="utf-8-sig").splitlines())))


def test_csv_is_npz_in_other_units(case: Path, made: Callable[..., Path]) -> None:
    ours, theirs = load_case(case), load_case(made(Truth()))
    assert [r.name for r in ours.runs] == [r.name for r in theirs.runs]
    for a, b in zip(ours.runs, theirs.runs, strict=True):
        np.testing.assert_allclose(a.time, b.time, atol=1e-6)
        np.testing.assert_allclose(a.command, b.command, atol=1e-6)
        for name in ("joint_pos", "joint_vel"):
            np.testing.assert_allclose(a.signals[name], b.signals[name], atol=1e-5)


def test_columns_with_the_contracts_own_names_need_no_map(case: Path) -> None:
    (case / "columns.json").unlink()
    t = np.arange(50) * 0.01
    table = {"time": t, "command_shoulder_servo": t, "command_elbow_servo": t}
    for path in (case / "runs").glob("*.csv"):
        write(path, table | {"joint_pos_shoulder": t, "joint_pos_elbow": -t}, delimiter=";")
    run = load_case(case).runs[0]
    assert run.signals["joint_pos"][-1] == pytest.approx([0.49, -0.49])
    assert set(run.signals) == {"joint_pos"}


def test_units_of_npz_runs_stand_in_log_json(made: Callable[..., Path], tmp_path: Path) -> None:
    folder = tmp_path / "case"
    shutil.copytree(made(Truth()), folder)
    log = json.loads((folder / "log.json").read_text())
    (folder / "log.json").write_text(json.dumps(log | {"units": {"time": "ms", "joint_pos": "deg"}}))
    for path in (folder / "runs").glob("*.npz"):
        with np.load(path) as data:
            np.savez(path, **{**data, "time": 1e3 * data["time"], "joint_pos": np.degrees(data["joint_pos"])})
    ours, theirs = load_case(folder).runs[0], load_case(made(Truth())).runs[0]
    np.testing.assert_allclose(ours.time, theirs.time, atol=1e-9)
    np.testing.assert_allclose(ours.signals["joint_pos"], theirs.signals["joint_pos"], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joint_pos": ["s_pso", "e_pos"]}, "did you mean s_pos"),
        ({"joint_pos": ["s_pos"]}, "shoulder, elbow"),
        ({"joint_poss": ["s_pos", "e_pos"]}, "did you mean joint_pos"),
        ({"time": {"column": "stamp", "unit": "usec"}}, "did you mean us"),
        ({"command": {"columns": ["s_des", "e_des"], "unit": "degree"}}, "did you mean deg"),
        ({"joint_pos": ["s_pos", {"column": "e_pos", "sign": 2}]}, "sign is 1 or -1"),
        ({"joint_pos": ["s_pos", 7]}, "cannot be read"),
        ({"command": None}, "'command' is missing"),
        ({"contact": ["s_pos"]}, "wrong number of columns"),
        ({"joint_pos": {"columns": 5}}, "joint_pos cannot be read"),
        ({"joint_pos": {"columns": ["s_pos", "e_pos"], "sign": None}}, "sign is 1 or -1"),
        ({"joint_pos": {"columns": ["s_pos", "e_pos"], "sign": 2}}, "sign is 1 or -1"),
        ({"joint_pos": {"columns": ["s_pos", "e_pos"], "units": "deg"}}, "did you mean unit"),
        ({"joint_pos": ["s_pos", {"column": "e_pos", "units": "deg"}]}, "did you mean unit"),
        ({"joint_pos": {"columns": ["s_pos", "e_pos"], "unit": None}}, "unknown unit 'None'"),
        ({"time": "stamp"}, "more than an hour"),
    ],
)
def test_wrong_maps_say_what_would_be_right(case: Path, change: dict[str, Any], said: str) -> None:
    remap(case, **change)
    with pytest.raises(RealsimError, match=said):
        load_case(case)


def test_without_a_map_the_expected_name_is_said(case: Path) -> None:
    (case / "columns.json").unlink()
    with pytest.raises(RealsimError, match=r"column 'time' of time[\s\S]*columns.json"):
        load_case(case)


def test_two_maps_are_one_too_many(case: Path) -> None:
    log = json.loads((case / "log.json").read_text())
    (case / "log.json").write_text(json.dumps(log | {"columns": MAP}))
    with pytest.raises(RealsimError, match="given twice"):
        load_case(case)


def test_same_run_twice_is_refused(case: Path) -> None:
    shutil.copy(case / "runs" / "run_01.csv", case / "runs" / "run_01.npz")
    with pytest.raises(RealsimError, match="two files of one run"):
        load_case(case)


def test_a_sign_and_a_unit_hold_for_all_columns(case: Path, made: Callable[..., Path]) -> None:
    remap(case, joint_vel={"columns": ["s_vel", "e_vel"], "unit": "rpm", "sign": -1})
    ours, theirs = load_case(case).runs[0], load_case(made(Truth())).runs[0]
    np.testing.assert_allclose(ours.signals["joint_vel"], -theirs.signals["joint_vel"], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows[1:], "no header"),
        (lambda rows: [*rows[:9], rows[9].replace(",walk", ',"walk'), *rows[10:]], r"does not end[\s\S]*row 10"),
        (lambda rows: [*rows[:9], rows[9].replace(",walk", ',"walk'), *200 * rows[10:]], r"does not end[\s\S]*row 10"),
        (lambda rows: rows[:1], "no samples"),
        (lambda rows: [rows[0].replace("s_des", "stamp"), *rows[1:]], "a column twice"),
        (lambda rows: [*rows[:9], rows[9] + ",3", *rows[10:]], "row 10"),
        (lambda rows: [*rows[:9], "oops" + rows[9][4:], *rows[10:]], r"text among numbers[\s\S]*row 10"),
        (lambda rows: rows[:15], "too short"),
    ],
)
def test_damaged_files_are_named(case: Path, change: Callable[[list[str]], list[str]], said: str) -> None:
    edit(case, change)
    with pytest.raises(RealsimError, match=said):
        load_case(case)


def test_empty_cells_are_missing_samples(case: Path) -> None:
    edit(
        case,
        lambda rows: [*rows[:30], ",".join(c if i != 3 else "" for i, c in enumerate(rows[30].split(","))), *rows[31:]],
    )
    position = load_case(case).runs[0].signals["joint_pos"]
    assert np.isnan(position[29, 0])
    assert np.isfinite(position[28, 0])


def test_wrapped_angles_are_unwrapped_and_said(case: Path) -> None:
    table = {"stamp": 1e4 * np.arange(80.0), "s_des": np.arange(80.0), "e_des": np.arange(80.0)}
    turning = 0.15 * np.arange(80)
    table |= {"s_pos": (turning + np.pi) % (2 * np.pi) - np.pi, "e_pos": np.arange(80.0)}
    table |= {"s_vel": np.ones(80), "e_vel": np.ones(80)}
    for path in (case / "runs").glob("*.csv"):
        write(path, table)
    found = load_case(case)
    np.testing.assert_allclose(found.runs[0].signals["joint_pos"][:, 0], turning, atol=1e-9)
    assert any("shoulder jumps by a turn 2 times" in w for w in found.warnings)
