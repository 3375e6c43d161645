"""Unitree G1 with 29 joints, as the paper trains it: gains, action scale and camera by the rules of its table."""

from __future__ import annotations

import re

import numpy as np

from realsim.core.geometry import R_to_quat, exp_so3
from realsim.robots.g1 import by_pattern, motors_by_joint, pd_gains, table
from realsim.robots.g1 import g1 as g1_robot
from trainer.robots.base import DepthMount, TrainedRobot
from trainer.robots.soles import sole_points

KEYFRAME = "KNEES_BENT_KEYFRAME"
"""The pose that action 0 asks for. From straight legs a step over a gap takes 1.7 units of action, from here 0.7."""
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
D435I_FOVY_DEG = 58.0
"""Vertical opening of the D435i's depth image in its 16:9 modes (data sheet: 87 x 58 degrees)."""


def g1() -> TrainedRobot:
    """G1 with bent knees; kp, kd and 0.25 effort / kp by the rule written there."""
    robot, figures = g1_robot(KEYFRAME), table()
    joints = tuple(j["name"] for j in figures["joints"])
    motors = motors_by_joint(figures)
    kp, kd = np.array([pd_gains(motors[j]["armature_kgm2"]) for j in joints]).T
    effort = np.array([motors[j]["effort_limit_Nm"] for j in joints])
    default = by_pattern(figures["keyframes"][KEYFRAME]["joint_pos"], list(joints))
    ranges = np.array([j["range"] for j in figures["joints"]])
    camera = figures["camera"]
    return TrainedRobot(
        robot=robot,
        joints=joints,
        default=np.array([default.get(j, 0.0) for j in joints]),
        action_scale=0.25 * effort / kp,
        kp=kp,
        kd=kd,
        effort=effort,
        velocity=np.array([_velocity_limit(motors[j]["armature_kgm2"], figures["motors"]) for j in joints]),
        lower=ranges[:, 0],
        upper=ranges[:, 1],
        base="pelvis",
        torso="torso_link",
        feet=FEET,
        soles=tuple(sole_points(robot.spec, foot) for foot in FEET),
        legs=_matching(joints, r".*_(hip|knee|ankle)_.*"),
        hips=_matching(joints, r".*_hip_(roll|yaw)_joint"),
        upper_body=_matching(joints, r"waist_.*|.*_(shoulder|elbow|wrist)_.*"),
        groups={
            "legs": _matching(joints, r".*_(hip|knee|ankle)_.*"),
            "waist": _matching(joints, r"waist_.*"),
            "arms": _matching(joints, r".*_(shoulder|elbow|wrist)_.*"),
        },
        standing_height=robot.base_height,
        camera=DepthMount(
            body=camera["body"],
            pos=np.array(camera["pos"]),
            quat=R_to_quat(exp_so3([0, camera["pitch_rad"], 0])),
            fovy_deg=D435I_FOVY_DEG,
        ),
        mirror=_mirror(joints),
    )


def _velocity_limit(armature: float, motors: dict[str, dict[str, float]]) -> float:
    """rad/s of the motor with this reflected inertia; ankles and waist are driven by a pair of the same motor."""
    for motor in motors.values():
        if np.isclose(armature / motor["armature_kgm2"], [1.0, 2.0]).any():
            return motor["velocity_limit_rad_s"]
    raise ValueError(f"no motor of the table has an armature of {armature} or half of it")


def _matching(joints: tuple[str, ...], pattern: str) -> tuple[int, ...]:
    return tuple(i for i, name in enumerate(joints) if re.fullmatch(pattern, name))


def _mirror(joints: tuple[str, ...]) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Left and right change places; rotations about x (roll) and z (yaw) change sign."""
    swap = {"left": "right", "right": "left"}
    other = [re.sub("^(left|right)", lambda m: swap[m[0]], name) for name in joints]
    index = tuple(joints.index(name) for name in other)
    return index, tuple(-1.0 if re.search("roll|yaw", name) else 1.0 for name in joints)
