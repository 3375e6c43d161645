"""What training needs to know of a robot, read from its model."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from realsim.core.geometry import R_to_quat, quat_to_R
from realsim.core.types import F64
from realsim.robots.base import LOOK, Robot
from trainer.errors import TrainerError
from trainer.robots.base import DepthMount, TrainedRobot
from trainer.robots.soles import sole_points

_NEAR_M, _ALONG = 0.02, 0.9
"""Joints are each other's mirror image if they lie this near and their axes have at least this cosine."""


def derived(
    robot: Robot,
    feet: tuple[str, ...],
    velocity: F64,
    *,
    torso: str = "",
    action_scale: F64 | None = None,
    hips: Sequence[str] | None = None,
    groups: dict[str, tuple[int, ...]] | None = None,
) -> TrainedRobot:
    """A robot to train from one whose model has a free joint, then a position servo for each hinge.

    Gains, limits of torque and angle are the model's, and so is the camera: its first, if it has one. Legs are the
    joints that lead to some feet and not to all, hips those of the upper half of a leg that do not turn about the
    robot's y axis. The mirror image is found by where joints lie in the default pose.

    Args:
        feet: bodies whose z axis points up in the default pose; left, right, left, right.
        velocity: (J,) rad/s of the motors.
        torso: the body whose tilt ends an episode; the base if empty.
        action_scale: (J,) rad; if not given 0.25 effort / kp, the rule of BeyondMimic (Liao et al. 2025).
        hips: names of joints, instead of the rule.
        groups: joints by part of the body, for the log; legs and what is above them if not given.

    Raises:
        TrainerError: no joint moves the feet, or one has no mirror image; it is named.
    """
    model = robot.spec.compile()
    data = mujoco.MjData(model)
    joints = tuple(model.joint(j).name for j in model.actuator_trnid[:, 0])
    default = np.array([robot.home.get(name, 0.0) for name in joints])
    data.qpos[:7], data.qpos[7:] = [0, 0, 0, 1, 0, 0, 0], default
    mujoco.mj_kinematics(model, data)
    number = {name: k for k, name in enumerate(joints)}
    paths = leg_paths(model, feet)
    legs = tuple(sorted({number[name] for path in paths for name in path}))
    if not legs:
        raise TrainerError(
            "no joint moves the feet", expected="hinges between the base and each foot", found=", ".join(feet),
            hint="correct the feet, or what is locked",
        )  # fmt: skip
    turned = tuple(sorted(number[name] for name in (hip_joints(data, paths) if hips is None else hips)))
    kp, effort = model.actuator_gainprm[:, 0].copy(), model.actuator_forcerange[:, 1].copy()
    rest = tuple(j for j in range(len(joints)) if j not in legs)
    return TrainedRobot(
        robot=robot,
        joints=joints,
        default=default,
        action_scale=0.25 * effort / kp if action_scale is None else action_scale,
        kp=kp,
        kd=-model.actuator_biasprm[:, 2],
        effort=effort,
        velocity=velocity,
        lower=model.jnt_range[1:, 0].copy(),
        upper=model.jnt_range[1:, 1].copy(),
        base=robot.root,
        torso=torso or robot.root,
        feet=feet,
        soles=tuple(sole_points(model, foot) for foot in feet),
        legs=legs,
        hips=turned,
        upper_body=rest,
        groups=groups or {"legs": legs} | ({"upper_body": rest} if rest else {}),
        standing_height=robot.base_height,
        camera=_mount(model) if model.ncam else None,
        mirror=mirror(
            joints,
            np.array([data.joint(name).xanchor for name in joints]),
            np.array([data.joint(name).xaxis for name in joints]),
        ),
    )


def mirror(joints: tuple[str, ...], places: F64, axes: F64) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Of each joint which one it is in the mirror, and with which sign.

    A rotation about (x, y, z) is one about (-x, y, -z) in the mirror that swaps left and right.

    Args:
        places: (J, 3) metres, the robot facing +x with its middle at y = 0.
        axes: (J, 3) unit vectors.

    Raises:
        TrainerError: a joint has no mirror image.
    """
    index, sign = [], []
    for name, place, axis in zip(joints, places, axes, strict=True):
        away = np.linalg.norm(places - place * [1, -1, 1], axis=1)
        along = axes @ (axis * [-1, 1, -1])
        fits = (away < _NEAR_M) & (abs(along) > _ALONG)
        if not fits.any():
            raise TrainerError(
                f"joint {name} has no mirror image",
                expected="a joint at the same place on the other side, in the default pose",
                found=f"the nearest is {joints[int(np.argmin(away))]}, {100 * away.min():.1f} cm away",
                hint="correct the default pose, or lock what has no counterpart (docs/robots)",
            )
        best = int(np.argmin(np.where(fits, away - 1e-3 * abs(along), np.inf)))
        index.append(best)
        sign.append(float(np.sign(along[best])))
    return tuple(index), tuple(sign)


def leg_paths(model: Any, feet: Sequence[str]) -> list[list[str]]:
    """For each foot the hinges that lead to it from the base, without those that lead to all feet."""
    paths = [joints_above(model, foot) for foot in feet]
    trunk = set.intersection(*map(set, paths))
    return [[name for name in path if name not in trunk] for path in paths]


def hip_joints(data: Any, paths: Sequence[Sequence[str]]) -> list[str]:
    """Joints of the upper half of each leg that do not turn about y, in the pose of `data`."""
    upper = dict.fromkeys(name for path in paths for name in path[: (len(path) + 1) // 2])
    return [name for name in upper if abs(data.joint(name).xaxis[1]) < 0.5]


def joints_above(model: Any, body: str) -> list[str]:
    """Names of the hinges between the base and a body, from the base on."""
    found: list[str] = []
    at = model.body(body).id
    while at:
        first, count = model.body_jntadr[at], model.body_jntnum[at]
        here = [j for j in range(first, first + count) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
        found = [model.joint(j).name for j in here] + found
        at = model.body_parentid[at]
    return found


def touching(model: Any, data: Any) -> set[tuple[str, ...]]:
    """Pairs of bodies in contact, each in the order of the alphabet."""
    pairs = set(map(tuple, data.contact.geom.tolist()))
    return {tuple(sorted(model.body(int(model.geom_bodyid[g])).name for g in pair)) for pair in pairs}


def _mount(model: Any) -> DepthMount:
    """The model's first camera as a mount that looks along +x."""
    body = model.body(int(model.cam_bodyid[0])).name
    R = quat_to_R(model.cam_quat[0]) @ LOOK.T
    return DepthMount(body, model.cam_pos[0].copy(), R_to_quat(R), float(model.cam_fovy[0]))
