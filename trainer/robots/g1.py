"""Unitree G1 with 29 joints, as the paper trains it: gains, action scale and camera by the rules of its table."""

import re

import numpy as np

from realsim.robots.g1 import g1 as g1_robot
from realsim.robots.g1 import motors_by_joint, table
from trainer.robots.base import TrainedRobot
from trainer.robots.derive import derived

KEYFRAME = "KNEES_BENT_KEYFRAME"
"""The pose that action 0 asks for. From straight legs a step over a gap takes 1.7 units of action, from here 0.7."""
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
PARTS = {
    "legs": r".*_(hip|knee|ankle)_.*",
    "waist": r"waist_.*",
    "arms": r".*_(shoulder|elbow|wrist)_.*",
}


def g1() -> TrainedRobot:
    """G1 with bent knees."""
    figures = table()
    joints = [j["name"] for j in figures["joints"]]
    motors = motors_by_joint(figures)
    velocity = [_velocity_limit(motors[j]["armature_kgm2"], figures["motors"]) for j in joints]
    groups = {part: tuple(i for i, j in enumerate(joints) if re.fullmatch(p, j)) for part, p in PARTS.items()}
    return derived(g1_robot(KEYFRAME), FEET, np.array(velocity), torso="torso_link", groups=groups)


def _velocity_limit(armature: float, motors: dict[str, dict[str, float]]) -> float:
    """rad/s of the motor with this reflected inertia; ankles and waist are driven by a pair of the same motor."""
    for motor in motors.values():
        if np.isclose(armature / motor["armature_kgm2"], [1.0, 2.0]).any():
            return motor["velocity_limit_rad_s"]
    raise ValueError(f"no motor of the table has an armature of {armature} or half of it")
