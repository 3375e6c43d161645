"""From an ambiguous diagnosis to command files, and from recordings back into a diagnosis."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap import load_case
from realsim.gap.case.split import split_runs
from realsim.gap.config import ExciteConfig
from realsim.gap.excite import excite
from realsim.gap.provenance import engine

from ...pages import read
from .conftest import SETTINGS, rival

SHORT = ExciteConfig(excitations=("two_gains",), seconds=3.0)


@pytest.fixture
def diagnosis(tmp_path: Path, pendulum: Path) -> Path:
    """The folder of an ambiguous diagnosis, as `realsim diagnose` writes it."""
    rivals = [
        rival("viscous_friction", ("swing",), damping=0.5),
        rival("damping_gain", ("swing",), ratio=float(np.log(1.5))),
    ]
    folder = tmp_path / "diagnosis"
    folder.mkdir()
    write(folder, {"case": str(pendulum), "rivals": [r.as_dict() for r in rivals]})
    return folder


def write(folder: Path, asked: dict | None, **more: object) -> None:
    data = {"verdict": "ambiguous", "causes": [{}], "equivalent": [[{}]], "next_experiment": asked}
    (folder / "diagnosis.json").write_text(json.dumps(data | {"provenance": {"engine": engine()}} | more))


def test_what_is_written_can_be_sent_recorded_and_read(tmp_path: Path, diagnosis: Path, pendulum: Path) -> None:
    out = tmp_path / "experiment"
    plan = excite(diagnosis, out, SHORT, SETTINGS)
    assert plan == json.loads((out / "experiment.json").read_text())
    assert plan["decides"]
    assert plan["excitation"] == "two_gains"
    assert "What each rival predicts" in read((out / "report.html").read_text())
    assert {f.name for f in (out / "commands").iterdir()} == {
        f"two_gains_{i}.{s}" for i in (1, 2) for s in ("csv", "npz")
    }
    with np.load(out / "commands" / "two_gains_1.npz") as data:
        time, command = data["time"], data["command"]
    table = np.loadtxt(out / "commands" / "two_gains_1.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.column_stack([time, command]), rtol=1e-4, atol=1e-6)
    for name in ("two_gains_1", "two_gains_2"):  # a robot that follows at once
        np.savez(out / "recorded" / f"{name}.npz", time=time, command=command, joint_pos=command, joint_vel=0 * command)
    before = sorted(pendulum.rglob("*"))
    case = load_case(pendulum, [out])
    assert case.added == ("two_gains_1", "two_gains_2")
    assert case.runs[-1].setup.gains == (("swing_servo", "kd", 2.0),)
    assert sorted(pendulum.rglob("*")) == before
    fitted, held = split_runs(case, SETTINGS)
    assert {case.runs[i].name for i in fitted} >= set(case.added)
    assert held
    with pytest.raises(GapError, match="holds recordings"):
        excite(diagnosis, out, SHORT, SETTINGS, overwrite=True)


def test_new_runs_are_fitted_though_others_are_livelier(pendulum: Path, tmp_path: Path) -> None:
    calm = tmp_path / "calm.npz"
    shutil.copy(next((pendulum / "runs").glob("*.npz")), calm)
    case = load_case(pendulum, [calm])
    many = case.with_runs((*case.runs[:3] * 3, case.runs[3]))
    fitted, held = split_runs(many, SETTINGS)
    assert len(many.runs) - 1 in fitted
    assert len(many.runs) - 1 not in held


def test_the_command_says_what_to_do(tmp_path: Path, diagnosis: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "experiment"
    options = ["--excitations", "two_gains", "--seconds", "3", "--threads", "1", "--json"]
    assert main(["excite", str(diagnosis), "--out", str(out), *options]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert plan["files"] == ["commands/two_gains_1.csv", "commands/two_gains_2.csv"]
    assert any("swing_servo kd" in line for line in plan["instructions"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"provenance": {"engine": "0123456789ab"}}, "another version"),
        ({"next_experiment": None, "verdict": "identified", "equivalent": []}, "nothing to tell apart"),
        ({"next_experiment": {"rivals": []}}, "nothing to tell apart"),
    ],
)
def test_diagnoses_that_cannot_be_used(tmp_path: Path, diagnosis: Path, change: dict, said: str) -> None:
    write(diagnosis, json.loads((diagnosis / "diagnosis.json").read_text())["next_experiment"], **change)
    refused(tmp_path, diagnosis, said)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"places": [["knee"]]}, "another robot"),
        ({"effect": "viscous_fraction"}, "viscous_fraction"),
        ({"values": {"damping": "much"}}, "cannot be read"),
        ({"values": {}}, "covariance"),
    ],
)
def test_rivals_of_another_robot_or_none(tmp_path: Path, diagnosis: Path, change: dict, said: str) -> None:
    asked = json.loads((diagnosis / "diagnosis.json").read_text())["next_experiment"]
    asked["rivals"][0]["causes"][0] |= change
    write(diagnosis, asked)
    refused(tmp_path, diagnosis, said)


def test_a_case_that_moved(tmp_path: Path, diagnosis: Path, pendulum: Path) -> None:
    asked = json.loads((diagnosis / "diagnosis.json").read_text())["next_experiment"]
    write(diagnosis, asked | {"case": "../elsewhere"})
    refused(tmp_path, diagnosis, "not where it was")
    assert excite(diagnosis, None, SHORT, SETTINGS, case=pendulum)["excitation"] == "two_gains"


def test_an_experiment_that_would_leave_the_limits_is_never_written(tmp_path: Path, diagnosis: Path) -> None:
    held = ExciteConfig(excitations=("chirp",), seconds=3.0, max_speed=1e-3)
    refused(tmp_path, diagnosis, "no experiment is written", held)


@pytest.mark.parametrize("wrong", [{"seconds": 60.0}, {"max_speed": 0.0}, {"max_torque": float("nan")}, {"seed": -1}])
def test_settings_out_of_range(wrong: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ExciteConfig(**wrong)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ((), "nothing was recorded"),
        (("run_01.npz",), "already"),
    ],
)
def test_recordings_that_cannot_be_used(tmp_path: Path, pendulum: Path, files: tuple, said: str) -> None:
    folder = tmp_path / "experiment"
    (folder / "recorded").mkdir(parents=True)
    (folder / "experiment.json").write_text("{}")
    for name in files:
        shutil.copy(pendulum / "runs" / "run_01.npz", folder / "recorded" / name)
    with pytest.raises(GapError, match=said):
        load_case(pendulum, [folder])
    with pytest.raises(GapError, match="no such recording"):
        load_case(pendulum, [tmp_path / "none.npz"])


def refused(tmp_path: Path, source: Path, said: str, config: ExciteConfig = SHORT) -> None:
    out = tmp_path / "experiment"
    with pytest.raises(Exception, match=said):
        excite(source, out, config, SETTINGS)
    assert not out.exists()
    assert not list(tmp_path.glob(".experiment*"))
