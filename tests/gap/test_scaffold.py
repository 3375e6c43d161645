"""A case from a model, and the health of a log alone."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap import check_case, load_case, start_case

from .truth import ARM, Truth


def test_a_new_case_wants_nothing_but_its_runs(made: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    folder = start_case(tmp_path / "arm.xml", tmp_path / "case")
    with pytest.raises(GapError, match="runs"):
        load_case(folder)
    full = made(Truth())
    shutil.rmtree(folder / "runs")
    shutil.copytree(full / "runs", folder / "runs")
    case, same = load_case(folder), load_case(full)
    assert (case.joint_names, case.actuator_names) == (same.joint_names, same.actuator_names)
    assert (case.command_kind, case.base) == (same.command_kind, same.base)
    assert "--check" in (folder / "README.md").read_text()


def test_a_body_that_flies_wants_its_pose_and_no_joints(tmp_path: Path) -> None:
    model = """<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size="0.1"/><site name="s"/></body></worldbody>
      <actuator><general name="m1" site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>"""
    (tmp_path / "drone.xml").write_text(model)
    folder = start_case(tmp_path / "drone.xml", tmp_path / "case")
    assert "joint_pos" not in (folder / "README.md").read_text()
    assert "base_pos_x" in (folder / "README.md").read_text()
    time = 0.01 * np.arange(200)
    pose = {"base_pos": np.tile([0.0, 0.0, 1.0], (200, 1)), "base_quat": np.tile([1.0, 0.0, 0.0, 0.0], (200, 1))}
    np.savez(folder / "runs" / "run_0.npz", time=time, command=np.ones((200, 1)), **pose)
    case = load_case(folder)
    assert (case.joint_names, case.actuator_names, case.base) == ((), ("m1",), "floating")
    (tmp_path / "still.xml").write_text(model.replace("<freejoint/>", '<joint name="hinge"/>'))
    with pytest.raises(GapError, match="no driven joint"):
        start_case(tmp_path / "still.xml", tmp_path / "case2")


def test_a_case_is_not_made_over_another_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "log.json").write_text("mine")
    command = ["diagnose", "--init", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "case")]
    assert main(command) == 2
    assert main([*command, "--overwrite"]) == 2
    assert (tmp_path / "case" / "log.json").read_text() == "mine"
    assert main([*command[:-1], str(tmp_path / "new")]) == 0
    assert "README.md" in capsys.readouterr().out


def test_a_case_without_runs_is_made_anew_and_one_with_runs_is_kept(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    command = ["diagnose", "--init", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "case"), "--overwrite"]
    assert main(command) == 0
    assert main(command) == 0
    (tmp_path / "case" / "runs" / "mine.csv").write_text("time\n0\n")
    assert main(command) == 2
    assert (tmp_path / "case" / "runs" / "mine.csv").is_file()


def test_models_that_no_log_can_refer_to_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(ARM.replace('joint name="', 'joint user="1" name="x').replace('name="x', 'class="main" dummy="'))
    with pytest.raises(GapError):
        start_case(path, tmp_path / "case")
    with pytest.raises(GapError, match="no such model"):
        start_case(tmp_path / "none.xml", tmp_path / "case")
    assert not (tmp_path / "case").exists()


def test_the_health_of_a_log_alone(
    made: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = made(Truth())
    found = check_case(case)
    assert len(found["runs"]) == 4
    assert main(["diagnose", str(case), "--check", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["health"]["clock"] == pytest.approx(found["health"]["clock"])
    broken = tmp_path / "broken"
    shutil.copytree(case, broken)
    (broken / "log.json").write_text("{}")
    assert main(["diagnose", str(broken), "--check"]) == 2
    assert main(["diagnose", str(case), str(broken), "--check"]) == 1
    assert "broken: cannot be used" in capsys.readouterr().out
