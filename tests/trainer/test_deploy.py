"""The loop on the robot: the same numbers as in training, on time, and stopped when something is wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from trainer.commands.deploy import body_of
from trainer.deploy.loop import DeployConfig, deploy
from trainer.deploy.mujoco import MujocoRobot
from trainer.deploy.observer import Observer
from trainer.deploy.robot import Reading
from trainer.errors import TrainerError
from trainer.ppo.export import Deployment
from trainer.robots import ROBOTS
from trainer.tasks.parkour import ParkourConfig, make
from trainer.tasks.parkour.config import CommandConfig, DepthConfig, ObservationConfig, RandomisationConfig, ResetConfig
from trainer.tasks.parkour.depth import crop
from trainer.terrain import generate

TASK = ParkourConfig(
    observation=ObservationConfig(noise=False),
    depth=DepthConfig(frames=3, stride=2).exact(),
    randomisation=RandomisationConfig(use=False, terrain_variants=1),
    reset=ResetConfig(position=0.0, yaw=0.0, joints=0.0, spread_ages=False),
)
QUADRUPED = ROBOTS["quadruped"]()


def facts(layout, **changes) -> Deployment:
    q = QUADRUPED
    numbers = [tuple(map(float, x)) for x in (q.default, q.action_scale, q.kp, q.kd)]
    return Deployment(layout, "quadruped", 0.02, *numbers, TASK.depth.near, TASK.depth.far, **changes)


def test_the_robot_observes_what_the_policy_was_trained_on() -> None:
    """Twelve steps of the task, read back through the deployment's own histories and depth stack."""
    env = make(TASK, [generate("boxes", 0.3, 1)], robot="quadruped", worlds=1)
    observe = Observer(facts(env.layout))
    robot = MujocoRobot(QUADRUPED, env.physics.terrains[0])
    robot.physics, robot.camera = env.physics, env.camera  # the task's own robot, read as a robot is
    observation = env.reset()
    rng = torch.Generator().manual_seed(0)
    action = torch.zeros(1, 12)
    for _ in range(12):
        command = np.array([float(env.command(env.physics.state).speed[0]), 0.0, 0.0])
        inputs = observe(robot.read(), command, action[0].numpy())
        assert np.allclose(inputs["vector"], observation.actor.numpy(), atol=1e-5)
        assert np.allclose(inputs["depth"], observation.depth.numpy(), atol=1e-5)
        action = torch.randn(1, 12, generator=rng)
        observation = env.step(action).observation


def test_a_policy_that_names_other_joints_than_its_robot_is_refused() -> None:
    layout = make(TASK, [generate("boxes", 0.3, 1)], robot="quadruped", worlds=1).layout
    body_of(facts(layout), Path("policy.onnx"))
    first, *rest = layout.actions
    for actions, found in ((("tail", *rest), "tail"), ((*rest, first), "another order")):
        with pytest.raises(TrainerError, match="other joints") as error:
            body_of(facts(replace(layout, actions=actions)), Path("policy.onnx"))
        assert found in error.value.render()


def test_a_steered_policy_is_told_the_way_and_only_such_a_one() -> None:
    """The command of the simulated robot's goal is the task's; nobody who steers is an error, not straight ahead."""
    task = replace(TASK, depth=DepthConfig(use=False), observation=ObservationConfig(noise=False, steered=True))
    task = replace(task, command=CommandConfig(speed=(0.8, 0.8)))
    env = make(task, [generate("boxes", 0.3, 1)], robot="quadruped", worlds=1)
    robot = MujocoRobot(QUADRUPED, env.physics.terrains[0], depth=False)
    robot.physics = env.physics
    env.reset()
    turned = torch.tensor([[np.cos(0.2), 0.0, 0.0, np.sin(0.2)]], dtype=torch.float32)  # 0.4 rad to the left
    here = torch.zeros(1, dtype=torch.long)
    start = torch.tensor([[0.0, 0.0, QUADRUPED.standing_height]])
    env.physics.reset(here, start, turned, torch.tensor(QUADRUPED.default, dtype=torch.float32)[None], here)
    said = robot.steer(0.8)
    assert said == pytest.approx([0.8 * np.cos(0.4), -0.8 * np.sin(0.4), -0.4], abs=1e-3)
    assert np.allclose(said, env.command(env.physics.state).observed(steered=True)[0], atol=1e-6)

    clock, session, steered = _Clock(), _Session(np.zeros(12)), facts(env.layout)
    with pytest.raises(TrainerError, match="trained to be steered"):
        deploy(_Robot(), session, steered, CONFIG, clock=clock, sleep=clock.sleep)
    asked: list[float] = []

    def steer(speed: float) -> np.ndarray:
        asked.append(speed)
        return np.array([0.1, 0.2, 0.3])

    deploy(_Robot(), session, steered, CONFIG, steer=steer, clock=clock, sleep=clock.sleep)
    assert np.allclose(session.seen[-1]["vector"][0, 8 * 6 + 21 : 8 * 6 + 24], [0.1, 0.2, 0.3])
    assert (asked[0], asked[-1]) == (0.0, pytest.approx(CONFIG.speed))
    deploy(_Robot(), session, BLIND, CONFIG, steer=steer, clock=clock, sleep=clock.sleep)
    assert np.allclose(session.seen[-1]["vector"][0, 8 * 6 + 21 : 8 * 6 + 24], [CONFIG.speed, 0.0, 0.0])


def test_a_full_image_is_cropped_as_in_training() -> None:
    full = np.arange(270 * 480, dtype=float).reshape(270, 480)
    assert crop(full, QUADRUPED.camera).shape == (18, 32)


class _Session:
    """A policy that always asks for the same action."""

    def __init__(self, action: np.ndarray) -> None:
        self.action = action
        self.seen: list[dict[str, np.ndarray]] = []

    def run(self, _, inputs):
        self.seen.append(inputs)
        return [self.action[None].astype(np.float32)]


class _Robot:
    """Remembers what it was told; `gravity` is what its inertial unit says."""

    def __init__(self, gravity=(0.0, 0.0, -1.0)) -> None:
        self.gravity = np.array(gravity)
        self.targets: list[np.ndarray] = []
        self.stops = 0

    def start(self, kp, kd) -> None:
        assert np.allclose(kp, QUADRUPED.kp)

    def read(self) -> Reading:
        return Reading(np.zeros(3), self.gravity, QUADRUPED.default.copy(), np.zeros(12))

    def write(self, targets) -> None:
        self.targets.append(targets)

    def stop(self) -> None:
        self.stops += 1


class _Clock:
    """Time that passes only when slept through, or by `work` seconds whenever it is asked."""

    def __init__(self, work: float = 0.0) -> None:
        self.now, self.work = 0.0, work

    def __call__(self) -> float:
        self.now += self.work
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


BLIND = facts(
    make(replace(TASK, depth=DepthConfig(use=False)), [generate("boxes", 0.3, 1)], robot="quadruped", worlds=1).layout
)
CONFIG = DeployConfig(seconds=0.2, ramp=0.1)


def test_fifty_times_a_second_with_a_rising_command() -> None:
    robot, clock, session = _Robot(), _Clock(), _Session(np.ones(12))
    report = deploy(robot, session, BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert (report.reason, report.steps, report.late, robot.stops) == ("done", 10, 0, 1)
    assert clock.now == pytest.approx(0.2)
    assert np.allclose(robot.targets[0], QUADRUPED.default + QUADRUPED.action_scale)
    command = [i["vector"][0, 8 * 6 + 21] for i in session.seen[1:]]  # newest command of the history
    assert command[0] == 0.0
    assert command[-1] == pytest.approx(CONFIG.speed)
    assert command == sorted(command)


def test_it_stops_rather_than_going_on() -> None:
    clock = _Clock()
    tilted = _Robot(gravity=(0.9, 0.0, -0.43))
    assert deploy(tilted, _Session(np.zeros(12)), BLIND, CONFIG, clock=clock, sleep=clock.sleep).reason == "tilted"
    assert (len(tilted.targets), tilted.stops) == (0, 1)
    broken = _Robot()
    report = deploy(broken, _Session(np.full(12, np.nan)), BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert "not a number" in report.reason
    assert (len(broken.targets), broken.stops) == (0, 1)

    class Wild(_Robot):
        def read(self) -> Reading:
            return replace(super().read(), joint_pos=np.full(12, 1e30))

    wild = Wild()
    report = deploy(wild, _Session(np.zeros(12)), BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert "two turns" in report.reason
    assert (len(wild.targets), wild.stops) == (0, 1)
    slow = _Clock(work=0.02)
    late = deploy(_Robot(), _Session(np.zeros(12)), BLIND, replace(CONFIG, seconds=9.0), clock=slow, sleep=slow.sleep)
    assert (late.reason, late.steps) == ("late", CONFIG.max_late)


@pytest.mark.parametrize("where", ["read", "sleep"])
def test_after_a_stall_it_keeps_time_again(where: str) -> None:
    """A tenth of a second is lost once: no burst of actions makes up for it, and every action is held for a step."""
    clock = _Clock()
    stalls = {where: 3}

    class Stalling(_Robot):
        def __init__(self) -> None:
            super().__init__()
            self.times: list[float] = []

        def read(self) -> Reading:
            clock.now += 0.002
            stall("read")
            return super().read()

        def write(self, targets) -> None:
            super().write(targets)
            self.times.append(clock.now)

    def stall(place: str) -> None:
        stalls[place] = stalls.get(place, 0) - 1
        clock.now += 0.1 * (stalls[place] == 0)

    def sleep(seconds: float) -> None:
        clock.sleep(seconds)
        stall("sleep")

    robot = Stalling()
    report = deploy(robot, _Session(np.zeros(12)), BLIND, CONFIG, clock=clock, sleep=sleep)
    assert (report.reason, report.steps, report.late) == ("done", 10, 1)
    gaps = np.diff(robot.times)
    assert sorted(gaps)[-1] == pytest.approx(0.12)
    assert np.delete(gaps, gaps.argmax()) == pytest.approx(0.02)


def test_actions_are_clipped_as_in_training() -> None:
    robot, clock, session = _Robot(), _Clock(), _Session(np.full(12, 3.0))
    limited = replace(BLIND, action_limit=1.5)
    deploy(robot, session, limited, CONFIG, clock=clock, sleep=clock.sleep)
    assert np.allclose(robot.targets[0], QUADRUPED.default + 1.5 * QUADRUPED.action_scale)
    assert np.allclose(session.seen[-1]["vector"][0, -12:], 1.5)  # the newest of the last actions


def test_a_start_that_fails_half_way_is_stopped_too() -> None:
    class Refusing(_Robot):
        def start(self, kp, kd) -> None:
            raise OSError("the third motor does not answer")

    robot = Refusing()
    with pytest.raises(OSError, match="third motor"):
        deploy(robot, _Session(np.zeros(12)), BLIND, CONFIG)
    assert robot.stops == 1


def test_a_policy_that_cannot_be_run_never_moves_the_robot() -> None:
    class Failing(_Session):
        def __init__(self, after: int) -> None:
            super().__init__(np.zeros(12))
            self.after = after

        def run(self, names, inputs):
            if len(self.seen) == self.after:
                raise RuntimeError("Attempting to broadcast an axis by a dimension other than 1")
            return super().run(names, inputs)

    robot, clock = _Robot(), _Clock()
    with pytest.raises(TrainerError, match="cannot be run"):
        deploy(robot, Failing(0), BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert robot.targets == []
    report = deploy(robot, Failing(3), BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert "broadcast" in report.reason
    assert (len(robot.targets), robot.stops) == (2, 1)
    with pytest.raises(TrainerError, match="another number"):
        deploy(robot, _Session(np.zeros(11)), BLIND, CONFIG, clock=clock, sleep=clock.sleep)


def test_wild_targets_are_clipped_and_counted() -> None:
    robot, clock = _Robot(), _Clock()
    report = deploy(robot, _Session(np.full(12, 100.0)), BLIND, CONFIG, clock=clock, sleep=clock.sleep)
    assert report.clipped == 12 * report.steps
    assert np.allclose(robot.targets[0], QUADRUPED.default + CONFIG.max_step)


def test_a_simulated_robot_stands_on_its_servos() -> None:
    robot = MujocoRobot(QUADRUPED, generate("boxes", 0.0, 1), depth=False)
    with pytest.raises(TrainerError, match="not been started"):
        robot.write(QUADRUPED.default)
    with pytest.raises(TrainerError, match="another kp"):
        robot.start(2 * QUADRUPED.kp, QUADRUPED.kd)
    report = deploy(robot, _Session(np.zeros(12)), BLIND, DeployConfig(seconds=1.0, realtime=False))
    assert report.reason == "done"
    assert robot.position[2] == pytest.approx(QUADRUPED.standing_height, abs=0.06)
    assert set(report.figures()["inference_ms"]) == {"p50", "p99", "max"}


def test_an_observation_that_cannot_be_given_is_named() -> None:
    with pytest.raises(TrainerError, match="base_lin_vel"):
        Observer(replace(BLIND, layout=replace(BLIND.layout, actor=(*BLIND.layout.actor, ("base_lin_vel", 24)))))
    with pytest.raises(TrainerError, match="does not fit"):
        sees = replace(BLIND, layout=replace(BLIND.layout, depth=(2, 18, 32)))
        Observer(sees)(_Robot().read(), np.zeros(3), np.zeros(12, np.float32))
