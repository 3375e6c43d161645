"""The log of a deployment, and the loop that begins with it, at toy size on the quadruped that ships."""

import json
import shutil
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import realsim as rs
from realsim.core.errors import RealsimError
from realsim.gap.case.case import load_case
from realsim.gap.checks.camera.recorded import depth_camera
from realsim.results import GapVerdict
from trainer.commands.close import close
from trainer.commands.common import find_terrain
from trainer.deploy import log as logs
from trainer.deploy.log import CaseLog
from trainer.deploy.loop import DeployConfig, deploy
from trainer.deploy.mujoco import MujocoRobot
from trainer.errors import TrainerError
from trainer.policies import FOLDER, TASKS, base_of
from trainer.ppo import export
from trainer.ppo.config import LoopConfig, PPOConfig
from trainer.robots import ROBOTS
from trainer.tasks.parkour.depth import rays
from trainer.trainers import TrainConfig, ppo

POLICY = FOLDER / "quadruped_parkour.onnx"
QUADRUPED = ROBOTS["quadruped"]()
CONFIG = DeployConfig(seconds=0.8, realtime=False)


def run(folder: Path, robot: MujocoRobot | None = None, seed: int = 0) -> tuple[CaseLog, object]:
    terrain, _ = find_terrain("boxes:0.2:1")
    session, facts = export.load(POLICY)
    robot = robot or MujocoRobot(QUADRUPED, terrain, seed=seed)
    log = CaseLog(folder, QUADRUPED, terrain, POLICY, facts, CONFIG)
    return log, deploy(robot, session, facts, CONFIG, log=log)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("log") / "case"
    for seed in (0, 1):
        run(folder, seed=seed)
    return folder


def test_a_run_is_a_case_without_a_note(case: Path) -> None:
    found = load_case(case)
    assert found.warnings == ()
    assert [r.name for r in found.runs] == ["run_0", "run_1"]
    assert {"base_pos", "base_quat", "contact", "joint_torque", "imu_gyro"} <= set(found.runs[0].signals)
    assert json.loads((case / "deploy.json").read_text())["runs"]["run_1"]["reason"] == "done"


def test_a_simulated_robot_stands_still_while_the_loop_is_late(tmp_path: Path) -> None:
    terrain, _ = find_terrain("boxes:0.2:1")
    session, facts = export.load(POLICY)
    config, now = DeployConfig(seconds=0.6, max_late=1000), [0.0]

    def clock() -> float:  # a machine that computes for up to 0.1 s between two looks at the clock
        now[0] += (0.013 * len(f"{now[0]}")) % 0.1
        return now[0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    log = CaseLog(tmp_path / "case", QUADRUPED, terrain, POLICY, facts, config)
    report = deploy(MujocoRobot(QUADRUPED, terrain), session, facts, config, log=log, clock=clock, sleep=sleep)
    assert report.late > 0
    (found,) = load_case(tmp_path / "case").runs
    np.testing.assert_allclose(found.time, 0.02 * np.arange(30), atol=1e-9)
    depth = np.load(tmp_path / "case" / "runs" / "run_0.npz")["depth_time"]
    np.testing.assert_allclose(depth, found.time, atol=1e-9)


def test_a_run_replayed_in_its_own_model_is_the_run_again(case: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(case / "model.xml"))
    log = json.loads((case / "log.json").read_text())
    run, data = np.load(case / "runs" / "run_1.npz"), mujoco.MjData(model)
    data.qpos, data.qvel = run["init_qpos"], run["init_qvel"]
    joints = [int(model.joint(name).qposadr[0]) for name in log["joint_names"]]
    for command, base, place in zip(run["command"], run["base_pos"], run["joint_pos"], strict=True):
        np.testing.assert_allclose(data.qpos[:3], base, atol=1e-3)
        np.testing.assert_allclose(data.qpos[joints], place, atol=1e-2)
        data.ctrl[[model.actuator(name).id for name in log["actuator_names"]]] = command
        mujoco.mj_step(model, data, round(0.02 / model.opt.timestep))
    assert np.abs(run["joint_pos"][-1] - run["joint_pos"][0]).max() > 0.1  # it moves


def test_the_logged_pinhole_has_the_rays_of_the_policys_pixels(case: Path) -> None:
    camera = depth_camera(load_case(case))
    width, height = QUADRUPED.camera.crop
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    directions = np.stack([np.ones_like(u, float), -(u - camera.cx) / camera.fx, -(v - camera.cy) / camera.fy], -1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    angle = np.arccos(np.clip((directions.reshape(-1, 3) * rays(QUADRUPED.camera)).sum(-1), -1, 1))
    assert angle.max() < 0.003  # half a pixel of the full image: the nearest one is kept


def test_a_driver_that_reads_no_number_stops_the_robot_and_the_log_is_kept(tmp_path: Path) -> None:
    terrain, _ = find_terrain("boxes:0.2:1")
    robot = MujocoRobot(QUADRUPED, terrain)
    read, count = robot.read, iter(range(100))

    def broken():
        reading = read()
        if next(count) == 30:
            reading.joint_vel[3] = np.nan
        return reading

    robot.read = broken
    _, report = run(tmp_path / "case", robot)
    assert (report.reason, report.steps, robot.stopped) == ("the robot's joint_vel is not a number", 30, True)
    assert len(load_case(tmp_path / "case").runs[0].time) == 30
    robot.read = lambda: (_ for _ in ()).throw(OSError("no link"))
    with pytest.raises(OSError, match="no link"):
        run(tmp_path / "case", robot)
    assert robot.stopped


def test_a_disk_without_room_refuses_before_the_robot_starts_and_a_lost_one_keeps_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as m:
        m.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1e6))
        with pytest.raises(RealsimError, match="no room"):
            run(tmp_path / "full")
    assert not (tmp_path / "full").exists()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(logs, "write_bytes", full)
    with pytest.raises(TrainerError, match="could not be written") as error:
        run(tmp_path / "lost")
    kept = Path(str(error.value.hint).rpartition(" ")[2])
    assert "observation" in np.load(kept)
    assert not list(tmp_path.iterdir())  # half a case is none
    kept.unlink()


@pytest.mark.parametrize("file", ["model.xml", "policy.onnx", "run_2.npz", "deploy.json"])
def test_a_further_run_that_cannot_be_written_leaves_the_case_as_it_was(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    other = tmp_path / "case"
    shutil.copytree(case, other)
    if file == "policy.onnx":
        (other / file).unlink()
    before = {path: path.read_bytes() for path in other.rglob("*") if path.is_file()}
    for name in ("write_bytes", "write_text"):
        write = getattr(logs, name)

        def full(path: Path, data: Any, write: Any = write) -> None:
            if path.name == file:
                raise RealsimError("cannot write", file=path, found="File too large")
            write(path, data)

        monkeypatch.setattr(logs, name, full)
    with pytest.raises(TrainerError, match="could not be written") as error:
        run(other)
    assert error.value.found == "File too large"
    assert {path: path.read_bytes() for path in other.rglob("*") if path.is_file()} == before
    Path(str(error.value.hint).rpartition(" ")[2]).unlink()


def test_a_run_that_can_be_kept_nowhere_leaves_no_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with a limit on the size of files, which no look at the free space tells."""
    begin = tempfile.NamedTemporaryFile

    def full(*_: object) -> None:
        raise OSError(27, "File too large")

    def begun(**options: Any) -> Any:
        file = begin(**options, dir=tmp_path)
        file.write = full
        return file

    monkeypatch.setattr(logs, "write_bytes", full)
    monkeypatch.setattr(tempfile, "NamedTemporaryFile", begun)
    with pytest.raises(TrainerError, match="could not be written") as error:
        run(tmp_path / "case")
    assert "it could not be kept elsewhere either" in str(error.value.hint)
    assert not list(tmp_path.iterdir())


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(TrainerError, match="something else"):
        run(tmp_path)


def test_close_stops_where_the_contract_is_broken_and_goes_on_where_it_was(case: Path, tmp_path: Path) -> None:
    other, out = tmp_path / "case", tmp_path / "closed"
    shutil.copytree(case, other)
    for file in (other / "runs").glob("*.npz"):
        data = dict(np.load(file))
        np.savez(file, **data | {"command": data["command"][:, ::-1]})
    for _ in range(2):  # the second time from what the first has left
        said = close(other, TrainConfig(), base_of("quadruped"), "boxes:0.2:1", out)
        assert said.data["contract"]["kept"] is False
        assert said.data["diagnosis"] == said.data["training"] == {}
        assert "joints are sent in another order" in (out / "report.html").read_text()
    with pytest.raises(TrainerError, match="another loop"):
        close(other, TrainConfig(), base_of("quadruped"), "boxes:0.3:1", out)


def test_a_healthy_robot_keeps_its_policy(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own simulator's log had ended in a page that asks for a look: `no_gap names nothing`."""
    found = SimpleNamespace(verdict=GapVerdict("no_gap"), sentence="No gap.", causes=())
    monkeypatch.setattr(rs, "diagnose", lambda *_, **__: found)
    said = close(case, TrainConfig(), base_of("quadruped"), "boxes:0.2:1", tmp_path)
    assert "nothing to do" in said.text
    assert 'class="verdict good"' in (tmp_path / "report.html").read_text()
    assert said.data["training"] == {}


@pytest.mark.slow
def test_close_fine_tunes_for_what_the_log_shows(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole loop on the quadruped, with a diagnosis of weak motors that is given: one iteration, a few trials."""
    cause = {
        "effect": "motor_gain", "joints": [], "bodies": [],
        "parameters": {"ratio": {"value": 0.9, "unit": "", "ci90": [0.88, 0.92]}},
    }  # fmt: skip

    def diagnosed(path: Path, out: Path, config: object, overwrite: bool) -> SimpleNamespace:
        out.mkdir(parents=True, exist_ok=True)
        (out / "diagnosis.json").write_text(json.dumps({"verdict": "identified", "causes": [cause], "equivalent": []}))
        return SimpleNamespace(verdict=GapVerdict("identified"), sentence="weak motors", causes=("motors at 90 %",))

    monkeypatch.setattr(rs, "diagnose", diagnosed)
    loop = LoopConfig(iterations=1, evaluate_every=0, tensorboard=False)
    config = TrainConfig(worlds=4, threads=1, device="cpu", loop=loop, ppo=PPOConfig(steps=8, epochs=1))
    task, out = tmp_path / "task.json", tmp_path / "closed"
    task.write_text(json.dumps(json.loads(TASKS["quadruped"].read_text()) | {"termination": {"seconds": 1.0}}))
    monkeypatch.setattr(ppo, "write_onnx", lambda path, *_: path)
    said = close(case, config, base_of("quadruped"), "boxes:0.2:1", out, final_trials=2, task_file=task)
    assert said.data["training"]["verdict"]["delivered"] == "base"
    assert "motors at 90 %" in (out / "report.html").read_text()
    assert "delivered" in said.text
