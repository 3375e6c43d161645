"""What the task needs to know of a robot agrees with the compiled robot. Run over the registry."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="the trainer needs torch")
import mujoco

from realsim.core.geometry import quat_to_R
from realsim.robots import ROBOTS as DESCRIBED
from trainer.robots import ROBOTS, TrainedRobot


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
