"""Unitree Go2 as the trainer sees it; its camera mount is ours (`realsim.robots.go2`)."""

from __future__ import annotations

import numpy as np

from realsim.core.geometry import R_to_quat, exp_so3
from realsim.robots.go2 import CAMERA, JOINTS, KD, KP, LEGS, table
from realsim.robots.go2 import go2 as go2_robot
from trainer.robots.base import DepthMount, TrainedRobot
from trainer.robots.quadruped import ACTION_SCALE_RAD, OPPOSITE
from trainer.robots.soles import sole_points

VELOCITY_RAD_S = {"hip": 30.1, "thigh": 30.1, "calf": 15.7}
"""Motor speeds as Unitree's URDF states them: the calf has twice the gear."""


def go2() -> TrainedRobot:
    """Twelve joints; its base is torso too, its feet are points."""
    robot, figures = go2_robot(), table()
    motors, ranges = figures["motors"], {j["name"]: j["range"] for j in figures["joints"]}
    kinds = [name.split("_")[1] for name in JOINTS]
    efforts = {"hip": "hip_and_thigh_effort_limit", "thigh": "hip_and_thigh_effort_limit", "calf": "calf_effort_limit"}
    feet = tuple(f"{leg}_foot" for leg in LEGS)
    legs = tuple(range(len(JOINTS)))
    return TrainedRobot(
        robot=robot,
        joints=JOINTS,
        default=np.array([robot.home[name] for name in JOINTS]),
        action_scale=np.full(len(JOINTS), ACTION_SCALE_RAD),
        kp=np.full(len(JOINTS), KP),
        kd=np.full(len(JOINTS), KD),
        effort=np.array([motors[efforts[k]] for k in kinds]),
        velocity=np.array([VELOCITY_RAD_S[k] for k in kinds]),
        lower=np.array([ranges[name][0] for name in JOINTS]),
        upper=np.array([ranges[name][1] for name in JOINTS]),
        base=robot.root,
        torso=robot.root,
        feet=feet,
        soles=tuple(sole_points(robot.spec, foot) for foot in feet),
        legs=legs,
        hips=tuple(i for i, kind in enumerate(kinds) if kind == "hip"),
        upper_body=(),
        groups={"legs": legs},
        standing_height=robot.base_height,
        camera=DepthMount(
            body=robot.root,
            pos=np.array(CAMERA.pos),
            quat=R_to_quat(exp_so3([0, CAMERA.pitch_rad, 0])),
            fovy_deg=CAMERA.fovy_deg,
        ),
        mirror=(
            tuple(JOINTS.index(f"{OPPOSITE[name[:2]]}{name[2:]}") for name in JOINTS),
            tuple(-1.0 if kind == "hip" else 1.0 for kind in kinds),
        ),
    )
