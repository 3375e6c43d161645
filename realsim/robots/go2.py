"""Unitree Go2: body tree, collision primitives and position servos from the table `go2.json`.

The table's figures are Unitree's description (BSD-3-Clause) as in MuJoCo Menagerie; it names its source. The feet,
spheres on the calves there, are bodies of their own here, level when the robot stands. Gains, motor speeds and the
camera are ours: the table has none.
"""

import json
from importlib.resources import files
from typing import Any

import numpy as np

from realsim.core.geometry import R_to_quat, exp_so3, quat_to_R
from realsim.robots.base import Robot, add_body, add_camera, add_servo, holding_ctrl
from realsim.robots.quadruped import Mount

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = tuple(f"{leg}_{name}_joint" for leg in LEGS for name in ("hip", "thigh", "calf"))
KP, KD = 40.0, 1.5
"""N m/rad and N m s/rad. In the pose `home` no joint sags by more than 0.24 rad under the weight."""
_TOUCH = 1e-4
"""Metres by which the feet of `home` lie in the ground, so that they touch it from the first step on."""
CAMERA = Mount("head", (0.30, 0.0, 0.06), 0.45, 58.0)
"""A D435i on the head, 26 degrees down: nothing that Unitree delivers. Another mount is another policy."""


def table() -> dict[str, Any]:
    """The robot's figures as read from `go2.json`; SI units, quaternions w x y z."""
    return dict(json.loads((files("realsim.robots") / "go2.json").read_text("utf-8")))


def go2() -> Robot:
    """Go2 as a free-floating body `base` in its key frame `home`, each joint with a position servo of its name."""
    import mujoco

    figures = table()
    pose, motors = figures["keyframes"]["home"], figures["motors"]
    spec = mujoco.MjSpec()
    spec.modelname = "go2"
    spec.compiler.degree = False
    bodies = {"world": spec.worldbody}
    for row in figures["bodies"]:
        bodies[row["name"]] = add_body(bodies[row["parent"]], row)
    bodies["base"].add_freejoint(name="floating_base")
    for row in figures["joints"]:
        effort = motors["calf_effort_limit" if "calf" in row["name"] else "hip_and_thigh_effort_limit"]
        _add_joint(spec, bodies[row["body"]], row, figures, effort)
    level = R_to_quat(exp_so3([0, -sum(pose["each_leg"]), 0]))
    for row in figures["collision_geoms"]:
        body = bodies[row["body"]]
        if row.get("foot"):
            body = body.add_body(name=f"{row['name']}_foot", pos=row["pos"], quat=level)
            body.add_site(name=f"{row['name']}_foot", pos=[0, 0, -row["radius"]], size=[0.005, 0.005, 0.005])
        _add_geom(body, row, figures["foot_friction"])
    add_camera(bodies["base"], CAMERA.name, CAMERA.pos, CAMERA.pitch_rad, CAMERA.fovy_deg)
    angles = list(pose["each_leg"]) * len(LEGS)
    height = _height(spec.compile(), angles)
    bodies["base"].pos = [0, 0, height]
    qpos = np.array([0, 0, height, 1, 0, 0, 0, *angles], float)
    sites = tuple(f"{leg}_foot" for leg in LEGS)
    spec.add_key(name="home", qpos=qpos, ctrl=holding_ctrl(spec.compile(), qpos, sites, below_com=False))
    return Robot("go2", spec, "base", height, dict(zip(JOINTS, angles, strict=True)))


def _add_joint(spec: Any, body: Any, row: dict[str, Any], figures: dict[str, Any], effort: float) -> None:
    import mujoco

    body.add_joint(
        name=row["name"],
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=row["axis"],
        range=row["range"],
        limited=True,
        armature=figures["joint_armature"],
        frictionloss=figures["joint_frictionloss_of_the_simulation_model"],
    )
    add_servo(spec, row["name"], KP, KD, effort)


_TURN_TO = ([0, np.pi / 2, 0], [-np.pi / 2, 0, 0], [0, 0, 0])
"""Rotation vectors that take z to x, y and z."""


def _add_geom(body: Any, row: dict[str, Any], foot_friction: list[float]) -> None:
    """Cylinders and boxes become capsules of the same length: their contacts are cheap and smooth, on a GPU too.

    A box's capsule has the mean of its two shorter sides; the model's boxes (trunk, thighs) are off by at most 6 mm.
    """
    import mujoco

    kind, quat = row["type"], row.get("quat", [1, 0, 0, 0])
    if kind == "box":
        longest = int(np.argmax(row["half_size"]))
        radius = float(np.delete(row["half_size"], longest).mean())
        row = row | {"radius": radius, "half_length": row["half_size"][longest]}
        quat = R_to_quat(quat_to_R(quat) @ exp_so3(_TURN_TO[longest]))
    round_ = kind == "sphere"
    size = [row["radius"], 0 if round_ else max(row["half_length"] - row["radius"], 1e-3), 0]
    foot = bool(row.get("foot"))
    geom = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE if round_ else mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=size,
        pos=[0, 0, 0] if foot else row["pos"],
        quat=quat,
        rgba=[0.75, 0.77, 0.8, 1],
        group=1,
        mass=0,
    )
    if foot:
        geom.name, geom.friction = f"{row['name']}_foot", foot_friction


def _height(model: Any, angles: list[float]) -> float:
    """Metres from the soles to the base in a pose."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:7], data.qpos[7:] = [0, 0, 0, 1, 0, 0, 0], angles
    mujoco.mj_kinematics(model, data)
    return -float(min(data.site(f"{leg}_foot").xpos[2] for leg in LEGS)) - _TOUCH
