"""The quadruped of `realsim.robots.quadruped`: small, light to simulate, the trainer's second robot."""

from __future__ import annotations

import numpy as np

from realsim.core.geometry import R_to_quat, exp_so3
from realsim.robots.quadruped import CAMERA, HOME, JOINTS, LEGS, MOTORS
from realsim.robots.quadruped import quadruped as quadruped_robot
from trainer.robots.base import DepthMount, TrainedRobot
from trainer.robots.soles import sole_points

ACTION_SCALE_RAD = 0.25
OPPOSITE = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}


def quadruped() -> TrainedRobot:
    """Twelve joints; its trunk is base and torso in one, its feet are points."""
    robot = quadruped_robot()
    motors = [MOTORS[name.split("_")[1]] for name in JOINTS]
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    swapped = [f"{OPPOSITE[name[:2]]}{name[2:]}" for name in JOINTS]
    return TrainedRobot(
        robot=robot,
        joints=JOINTS,
        default=np.array([*HOME.values()] * len(LEGS)),
        action_scale=np.full(len(JOINTS), ACTION_SCALE_RAD),
        kp=np.array([m.kp for m in motors]),
        kd=np.array([m.kd for m in motors]),
        effort=np.array([m.effort for m in motors]),
        velocity=np.array([m.velocity for m in motors]),
        lower=np.array([m.span[0] for m in motors]),
        upper=np.array([m.span[1] for m in motors]),
        base=robot.root,
        torso=robot.root,
        feet=feet,
        soles=tuple(sole_points(robot.spec, foot) for foot in feet),
        legs=tuple(range(len(JOINTS))),
        hips=tuple(i for i, name in enumerate(JOINTS) if "_hip_" in name),
        upper_body=(),
        groups={"legs": tuple(range(len(JOINTS)))},
        standing_height=robot.base_height,
        camera=DepthMount(
            body=robot.root,
            pos=np.array(CAMERA.pos),
            quat=R_to_quat(exp_so3([0, CAMERA.pitch_rad, 0])),
            fovy_deg=CAMERA.fovy_deg,
        ),
        mirror=(
            tuple(JOINTS.index(name) for name in swapped),
            tuple(-1.0 if "_hip_" in name else 1.0 for name in JOINTS),
        ),
    )
