"""The quadruped of `realsim.robots.quadruped`: small, light to simulate, the trainer's second robot."""

import numpy as np

from realsim.robots.quadruped import JOINTS, LEGS, MOTORS
from realsim.robots.quadruped import quadruped as quadruped_robot
from trainer.robots.base import TrainedRobot
from trainer.robots.derive import derived

ACTION_SCALE_RAD = 0.25


def quadruped() -> TrainedRobot:
    """Twelve joints; its trunk is base and torso in one, its feet are points."""
    velocity = np.array([MOTORS[name.split("_")[1]].velocity for name in JOINTS])
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    return derived(quadruped_robot(), feet, velocity, action_scale=np.full(len(JOINTS), ACTION_SCALE_RAD))
