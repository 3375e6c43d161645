"""What the task needs to know of a robot agrees with the compiled robot. Run over the registry."""

import mujoco
import numpy as np
import pytest

from realsim.core.geometry import quat_to_R
from realsim.robots import ROBOTS as DESCRIBED
from realsim.robots import Robot
from trainer import robots, terrain
from trainer.physics import ENGINES, PhysicsConfig
from trainer.robots import ROBOTS, TrainedRobot
from trainer.tasks.parkour.gap import _nominal_friction


@pytest.fixture(scope="module", params=list(ROBOTS))
def robot(request) -> TrainedRobot:
    return ROBOTS[request.param]()


@pytest.fixture(scope="module")
def model(robot: TrainedRobot) -> mujoco.MjModel:
    return robot.robot.spec.compile()


def at_default(robot: TrainedRobot, model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[7:] = robot.default
    mujoco.mj_forward(model, data)
    return data


def test_every_robot_is_described_too() -> None:
    assert set(ROBOTS) <= set(DESCRIBED)


def test_figures_are_the_models(robot: TrainedRobot, model: mujoco.MjModel) -> None:
    assert [model.actuator(i).name for i in range(model.nu)] == list(robot.joints)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], robot.kp)
    np.testing.assert_allclose(model.actuator_biasprm[:, 2], -robot.kd)
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], robot.effort)
    np.testing.assert_allclose(model.jnt_range[1:], np.stack([robot.lower, robot.upper], axis=1))
    assert np.all((robot.lower < robot.default) & (robot.default < robot.upper))
    for array in (robot.action_scale, robot.velocity):
        assert array.shape == robot.kp.shape
        assert np.all(array > 0)


def test_every_joint_is_a_leg_or_above(robot: TrainedRobot) -> None:
    assert sorted(robot.legs + robot.upper_body) == list(range(len(robot.joints)))
    assert set(robot.hips) < set(robot.legs)


def test_soles_are_the_lowest_points_and_standing_height_above_them(robot: TrainedRobot, model: mujoco.MjModel) -> None:
    data = at_default(robot, model)
    base = data.body(robot.base).xpos[2]
    for foot, points in zip(robot.feet, robot.soles, strict=True):
        body = data.body(foot)
        heights = (body.xpos + points @ body.xmat.reshape(3, 3).T)[:, 2]
        assert base - heights.min() == pytest.approx(robot.standing_height, abs=0.005)


def test_camera_looks_ahead_and_down(robot: TrainedRobot, model: mujoco.MjModel) -> None:
    """The mount agrees with the MuJoCo camera of the description: same place, same direction."""
    data = at_default(robot, model)
    mount = robot.camera
    body = data.body(mount.body)
    R = body.xmat.reshape(3, 3)
    np.testing.assert_allclose(body.xpos + R @ mount.pos, data.cam_xpos[0], atol=1e-9)
    looks = R @ quat_to_R(mount.quat) @ [1, 0, 0]
    np.testing.assert_allclose(looks, -data.cam_xmat[0].reshape(3, 3)[:, 2], atol=1e-6)
    assert looks[0] > 0.3
    assert looks[2] < -0.3
    assert model.cam_fovy[0] == mount.fovy_deg


def test_mirroring_twice_is_nothing_and_mirrors_the_feet(robot: TrainedRobot, model: mujoco.MjModel) -> None:
    index, sign = (np.array(x) for x in robot.mirror)
    q = robot.default + np.random.default_rng(0).uniform(-0.3, 0.3, len(robot.joints))
    mirrored = sign * q[index]
    np.testing.assert_allclose(sign * mirrored[index], q)
    np.testing.assert_allclose(sign * robot.default[index], robot.default)

    def feet(joints: np.ndarray) -> np.ndarray:
        data = mujoco.MjData(model)
        data.qpos[7:] = joints
        mujoco.mj_kinematics(model, data)
        return np.array([data.body(f).xpos - data.body(robot.base).xpos for f in robot.feet])

    ours, theirs = feet(q) * [1, -1, 1], feet(mirrored)
    for foot in ours:  # the left foot of one is the right foot of the other
        assert np.linalg.norm(theirs - foot, axis=1).min() < 1e-3


DOG = """
<mujoco><worldbody><body name="trunk" pos="0 0 0.3"><freejoint/>
  <geom type="box" size="0.2 0.1 0.05" mass="6"/>
  <geom type="box" size="0.4 0.4 0.4" contype="0" conaffinity="0" mass="0"/>
  {legs}
</body></worldbody><actuator>{motors}</actuator></mujoco>
"""
LEG = """<body name="{n}_hip" pos="{x} {y} 0"><joint name="{n}" axis="0 1 0" range="-1 1" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
  <body name="{n}_foot" pos="0 0 -0.25"><geom type="sphere" size="0.03" mass="0.1" friction="1.5 0.005 0.0001"/></body>
</body>"""


def dog() -> TrainedRobot:
    """A robot of one's own: mass on its geoms, a drawn shell that must not collide, feet with a friction of 1.5."""
    names = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, (x, y) in names.items())
    motors = "".join(
        f'<general name="{n}" joint="{n}" gainprm="60" biastype="affine" biasprm="0 -60 -2" forcerange="-30 30"/>'
        for n in names
    )
    spec = mujoco.MjSpec.from_string(DOG.format(legs=legs, motors=motors))
    joints, feet, one = tuple(names), tuple(f"{n}_foot" for n in names), np.ones(4)
    return TrainedRobot(
        Robot("dog", spec, "trunk", 0.28, {}), joints, 0 * one, 0.25 * one, 60 * one, 2 * one, 30 * one, 20 * one,
        -one, one, "trunk", "trunk", feet, tuple(np.array([[0.0, 0.0, -0.03]]) for _ in feet), (0, 1, 2, 3), (), (),
        {"legs": (0, 1, 2, 3)}, 0.28, None, ((1, 0, 3, 2), (1.0,) * 4),
    )  # fmt: skip


def test_a_robot_of_ones_own_keeps_its_masses_its_shell_and_its_friction() -> None:
    """Masses on geoms, geoms that are only drawn and a friction that is not 1 were a crash, a collision and a wrong
    coefficient."""
    import torch

    robot = dog()
    physics = ENGINES["mujoco"](robot, [terrain.flat()], 1, PhysicsConfig(threads=1))
    for _ in range(50):
        physics.step(torch.zeros(1, 4))
    assert float(physics.state.base_pos[0, 2]) == pytest.approx(0.28, abs=0.02)
    assert not physics.state.other_contact[0]  # the shell reaches below the ground
    assert float(physics.state.foot_force.sum()) == pytest.approx(8.4 * 9.81, rel=0.05)
    assert _nominal_friction(robot) == 1.5


def test_installed_packages_add_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.metadata

    point = importlib.metadata.EntryPoint("dog", "tests.trainer.test_robots:dog", "realsim.robots")
    known = importlib.metadata.entry_points

    def found(group: str):
        return [point] if group == "realsim.robots" else known(group=group)

    with monkeypatch.context() as m:
        m.setattr(importlib.metadata, "entry_points", found)
        assert importlib.reload(robots).named("dog").robot.name == "dog"
    importlib.reload(robots)
