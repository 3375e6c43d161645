"""Unitree Go2 as the trainer sees it; its camera mount is ours (`realsim.robots.go2`)."""

import numpy as np

from realsim.robots.go2 import JOINTS, LEGS
from realsim.robots.go2 import go2 as go2_robot
from trainer.robots.base import TrainedRobot
from trainer.robots.derive import derived
from trainer.robots.quadruped import ACTION_SCALE_RAD

VELOCITY_RAD_S = {"hip": 30.1, "thigh": 30.1, "calf": 15.7}
"""Motor speeds as Unitree's URDF states them: the calf has twice the gear."""


def go2() -> TrainedRobot:
    """Twelve joints; its base is torso too, its feet are points."""
    velocity = np.array([VELOCITY_RAD_S[name.split("_")[1]] for name in JOINTS])
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    return derived(go2_robot(), feet, velocity, action_scale=np.full(len(JOINTS), ACTION_SCALE_RAD))
