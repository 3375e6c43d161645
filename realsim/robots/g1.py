"""Unitree G1, 29 joints: body tree, collision primitives and position servos from the table `g1.json`.

The table's figures are Unitree's description (BSD-3-Clause) as shipped by mjlab (Apache-2.0); it names its sources.
"""

import json
import re
from importlib.resources import files
from math import pi
from typing import Any

import numpy as np

from realsim.robots.base import Robot, add_body, add_camera, add_servo, holding_ctrl

NATURAL_FREQUENCY = 2 * pi * 10  # rad/s, of every servo with its reflected inertia
DAMPING_RATIO = 2.0
# Neighbours but one: their capsules overlap in every pose, so a contact between them says nothing.
OVERLAPPING = tuple(
    pair
    for side in ("left", "right")
    for pair in (("pelvis", f"{side}_hip_roll_link"), (f"{side}_elbow_link", f"{side}_wrist_pitch_link"))
)


def table() -> dict[str, Any]:
    """The robot's figures as read from `g1.json`; SI units, quaternions w x y z."""
    return json.loads((files("realsim.robots") / "g1.json").read_text("utf-8"))


def pd_gains(armature: float) -> tuple[float, float]:
    """(stiffness N m/rad, damping N m s/rad) of a servo on a joint of this reflected inertia in kg m^2.

    kp = I w^2 and kd = 2 zeta I w with w = 2 pi 10 Hz and zeta = 2 (BeyondMimic, Liao et al. 2025).
    """
    return armature * NATURAL_FREQUENCY**2, 2 * DAMPING_RATIO * armature * NATURAL_FREQUENCY


def action_scale(armature: float, effort_limit: float) -> float:
    """Radians a unit of action, 0.25 effort / kp (same source): a full action asks for a quarter of the torque."""
    return 0.25 * effort_limit / pd_gains(armature)[0]


def by_pattern(patterns: dict[str, float], names: list[str]) -> dict[str, float]:
    """{name: value of the first pattern that matches the whole name}; names without a match are left out."""
    found = {name: next((v for p, v in patterns.items() if re.fullmatch(p, name)), None) for name in names}
    return {name: value for name, value in found.items() if value is not None}


def g1(keyframe: str = "HOME_KEYFRAME") -> Robot:
    """Unitree G1 as a free-floating body standing in `keyframe`, its actuators holding that pose.

    29 hinge joints named as by Unitree, each with a position servo of the same name (ctrl = target angle, radians,
    torque limited to the motor's). Collision geoms are in group 1, sites `left_foot` and `right_foot` lie on the soles.
    """
    import mujoco

    figures = table()
    joints = [j["name"] for j in figures["joints"]]
    pose = figures["keyframes"][keyframe]
    home = by_pattern(pose["joint_pos"], joints)

    spec = mujoco.MjSpec()
    spec.modelname = "g1"
    spec.compiler.degree = False
    bodies = {"world": spec.worldbody}
    for row in figures["bodies"]:
        bodies[row["name"]] = add_body(bodies[row["parent"]], row)
    pelvis = bodies["pelvis"]
    pelvis.pos = pose["base_pos"]
    pelvis.add_freejoint(name="floating_base")
    motors = motors_by_joint(figures)
    for row in figures["joints"]:
        bodies[row["body"]].add_joint(
            name=row["name"],
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=row["axis"],
            pos=row["pos"],
            range=row["range"],
            limited=True,
            armature=motors[row["name"]]["armature_kgm2"],
        )
        motor = motors[row["name"]]
        add_servo(spec, row["name"], *pd_gains(motor["armature_kgm2"]), motor["effort_limit_Nm"])
    for row in figures["collision_geoms"]:
        _add_geom(bodies[row["body"]], row)
    for row in figures["sites"]:
        bodies[row["body"]].add_site(name=row["name"], pos=row["pos"], quat=row["quat"], size=[0.01, 0.01, 0.01])
    for a, b in OVERLAPPING:
        spec.add_exclude(bodyname1=a, bodyname2=b)
    camera = figures["camera"]
    add_camera(bodies[camera["body"]], camera["name"], camera["pos"], camera["pitch_rad"], 58.0)
    qpos = np.array([*pose["base_pos"], 1, 0, 0, 0, *(home.get(name, 0.0) for name in joints)])
    spec.add_key(name="home", qpos=qpos, ctrl=holding_ctrl(spec.compile(), qpos, ("left_foot", "right_foot")))
    return Robot("g1", spec, "pelvis", float(pose["base_pos"][2]), home)


def motors_by_joint(figures: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """{joint: its actuator group}; every joint is in exactly one."""
    found = {}
    for joint in (j["name"] for j in figures["joints"]):
        groups = [g for g in figures["actuator_groups"] if any(re.fullmatch(p, joint) for p in g["joints"])]
        if len(groups) != 1:
            raise ValueError(f"{joint} is in {len(groups)} actuator groups")
        found[joint] = groups[0]
    return found


def _add_geom(body: Any, row: dict[str, Any]) -> None:
    import mujoco

    kinds = {"sphere": mujoco.mjtGeom.mjGEOM_SPHERE, "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE}
    body.add_geom(
        name=row["name"],
        type=kinds[row["type"]],
        size=(row["size"] + [0, 0])[:3],
        pos=row["pos"],
        quat=row["quat"],
        rgba=[0.75, 0.77, 0.8, 1],
        group=1,  # there are no visual meshes: the primitives are what one sees
        mass=0,
    )
