"""A quadruped of our own, 12 joints and 13 kg: the fast second robot of the trainer.

Its figures are plausible ones of a small electric quadruped (a trunk of 0.38 m on legs of twice 0.2 m, geared motors
of 24 to 36 N m), written down here and belonging to no product. Every collision geom is a capsule or a sphere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.geometry import R_to_quat, exp_so3
from realsim.robots.base import Robot, add_camera, add_servo, holding_ctrl


@dataclass(frozen=True)
class Part:
    """A link: a solid block for its inertia, capsules for contact. Lengths in metres, masses in kg."""

    mass: float
    com: tuple[float, float, float]
    block: tuple[float, float, float]
    """Edge lengths of the homogeneous block that has the link's inertia."""


@dataclass(frozen=True)
class Mount:
    """A camera on the trunk that looks along +x, pitched down by `pitch_rad`; vertical opening in degrees."""

    name: str
    pos: tuple[float, float, float]
    pitch_rad: float
    fovy_deg: float


@dataclass(frozen=True)
class Motor:
    """One servo. `kp` N m/rad, `kd` N m s/rad, `effort` N m, `velocity` rad/s, `armature` kg m^2, `span` rad."""

    effort: float
    span: tuple[float, float]
    kp: float = 60.0
    kd: float = 2.0
    velocity: float = 25.0
    armature: float = 0.01


THIGH_M = CALF_M = 0.2
FOOT_RADIUS_M = 0.022
HIP_AT = (0.19, 0.05)
"""x and y of the hip's abduction axis in the trunk, mirrored to the four corners."""
THIGH_OFFSET_M = 0.08
TRUNK = Part(6.2, (0.0, 0.0, 0.005), (0.36, 0.16, 0.11))
HIP = Part(0.6, (0.0, 0.02, 0.0), (0.08, 0.08, 0.08))
THIGH = Part(0.9, (0.0, 0.0, -0.05), (0.05, 0.05, 0.22))
CALF = Part(0.2, (0.0, 0.0, -0.09), (0.03, 0.03, 0.2))
FOOT = Part(0.05, (0.0, 0.0, 0.0), (0.04, 0.04, 0.04))
MOTORS = {
    "hip": Motor(24.0, (-0.8, 0.8)),
    "thigh": Motor(24.0, (-1.2, 2.8)),
    "calf": Motor(36.0, (-2.6, -0.5)),
}
HOME = {"hip": 0.0, "thigh": 0.75, "calf": -1.5}
"""Radians: the feet stand below the hips."""
LEGS = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}
"""Leg -> signs of x and y of its corner."""
CAMERA = Mount("head", (0.26, 0.0, 0.05), 0.45, 58.0)
JOINTS = tuple(f"{leg}_{motor}_joint" for leg in LEGS for motor in MOTORS)


def quadruped() -> Robot:
    """The quadruped as a free-floating body `trunk` that stands in its key frame `home`.

    Joints are named `FL_hip_joint` ... `RR_calf_joint` (abduction, thigh, calf), each with a position servo of the same
    name; feet are bodies of their own (`FL_foot`), with sites of the same name at their lowest point.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.modelname = "quadruped"
    spec.compiler.degree = False
    height = FOOT_RADIUS_M + THIGH_M * np.cos(HOME["thigh"]) + CALF_M * np.cos(HOME["thigh"] + HOME["calf"])
    trunk = _add_body(spec.worldbody, "trunk", (0.0, 0.0, height), TRUNK)
    trunk.add_freejoint(name="floating_base")
    for y in (-0.04, 0.04):
        _add_capsule(trunk, f"trunk_{'left' if y > 0 else 'right'}", 0.055, (-0.16, y, 0.0), (0.16, y, 0.0))
    trunk.add_geom(name="head", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], pos=[0.24, 0, 0.02], mass=0)
    add_camera(trunk, CAMERA.name, CAMERA.pos, CAMERA.pitch_rad, CAMERA.fovy_deg)
    for leg, signs in LEGS.items():
        _add_leg(spec, trunk, leg, *signs)
    qpos = np.array([0, 0, height, 1, 0, 0, 0, *list(HOME.values()) * len(LEGS)], float)
    sites = tuple(f"{leg}_foot" for leg in LEGS)
    spec.add_key(name="home", qpos=qpos, ctrl=holding_ctrl(spec.compile(), qpos, sites, below_com=False))
    home = {f"{leg}_{motor}_joint": angle for leg in LEGS for motor, angle in HOME.items()}
    return Robot("quadruped", spec, "trunk", float(height), home)


def _add_leg(spec: Any, trunk: Any, leg: str, front: int, left: int) -> None:
    import mujoco

    x, y = HIP_AT
    hip = _add_body(trunk, f"{leg}_hip", (front * x, left * y, 0.0), HIP, left)
    thigh = _add_body(hip, f"{leg}_thigh", (0.0, left * THIGH_OFFSET_M, 0.0), THIGH)
    calf = _add_body(thigh, f"{leg}_calf", (0.0, 0.0, -THIGH_M), CALF)
    foot = _add_body(calf, f"{leg}_foot", (0.0, 0.0, -CALF_M), FOOT)
    foot.quat = R_to_quat(exp_so3([0, -HOME["thigh"] - HOME["calf"], 0]))  # level when the robot stands
    for body, name, axis in ((hip, "hip", (1, 0, 0)), (thigh, "thigh", (0, 1, 0)), (calf, "calf", (0, 1, 0))):
        _add_joint(spec, body, f"{leg}_{name}_joint", axis, MOTORS[name])
    # The capsules end short of the joints: neighbours' neighbours must not touch in any pose of normal use.
    _add_capsule(hip, f"{leg}_hip", 0.04, (0.0, left * 0.05, 0.0), (0.0, left * 0.07, 0.0))
    _add_capsule(thigh, f"{leg}_thigh", 0.022, (0.0, 0.0, -0.04), (0.0, 0.0, -THIGH_M))
    _add_capsule(calf, f"{leg}_calf", 0.014, (0.0, 0.0, -0.02), (0.0, 0.0, -CALF_M + 0.03))
    foot.add_geom(name=f"{leg}_foot", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS_M, 0, 0], mass=0, group=1)
    foot.add_site(name=f"{leg}_foot", pos=[0, 0, -FOOT_RADIUS_M], size=[0.005, 0.005, 0.005])


def _add_body(parent: Any, name: str, pos: tuple[float, float, float], part: Part, left: int = 1) -> Any:
    a, b, c = part.block
    return parent.add_body(
        name=name,
        pos=pos,
        mass=part.mass,
        ipos=[part.com[0], left * part.com[1], part.com[2]],
        inertia=[part.mass / 12 * (b * b + c * c), part.mass / 12 * (a * a + c * c), part.mass / 12 * (a * a + b * b)],
        explicitinertial=True,
    )


def _add_joint(spec: Any, body: Any, name: str, axis: tuple[int, int, int], motor: Motor) -> None:
    import mujoco

    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        range=motor.span,
        limited=True,
        armature=motor.armature,
    )
    add_servo(spec, name, motor.kp, motor.kd, motor.effort)


def _add_capsule(body: Any, name: str, radius: float, a: tuple[float, ...], b: tuple[float, ...]) -> None:
    import mujoco

    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*a, *b],
        size=[radius, 0, 0],
        rgba=[0.75, 0.77, 0.8, 1],
        group=1,
        mass=0,
    )
