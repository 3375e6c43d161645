"""What a model says of a robot that is to be trained, and a guess with its reason for what it does not."""

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from realsim.core.geometry import quat_to_R
from realsim.robots.base import LOOK
from realsim.robots.g1 import pd_gains
from trainer.errors import TrainerError
from trainer.robots.derive import hip_joints, joints_above, leg_paths, touching
from trainer.robots.file import (
    Mount,
    RobotFile,
    Servo,
    compiled,
    float_base,
    in_pose,
    lowest,
    opened,
    standing_height,
    strip,
)
from trainer.robots.soles import collides, outline

FOOT_M = 0.04
"""Bodies whose lowest point is at most this much above the lowest of all are feet."""
SAG_RAD = 0.6
"""Where no reflected inertia is known, a servo's stiffness gives its whole torque at this error. Go2's motors and its
gains of 40 N m/rad have this ratio."""
DAMPING_S = 0.05
"""kd / kp where nothing else is known."""
_ALONG_Y = 0.9
SPEED_RAD_S = 20.0
"""Speed of a motor of which nothing is known; Go2's have 16 and 30, G1's 20 to 37."""
CAMERA_PITCH_DEG = 26.0
"""That of the mounts that ship: it sees the ground from 0.3 to 2 m ahead."""


def guess(path: Path, out: Path) -> tuple[RobotFile, dict[str, str]]:
    """A robot's file for an MJCF or URDF model, and the reason of each guess by entry.

    Args:
        path: the model.
        out: where the file will be: the model is named relative to it.

    Raises:
        TrainerError: the model cannot be read, has no joint to drive, or is no robot that walks.
    """
    spec, reasons = opened(path), {}
    drives = _drives(spec, path)
    keyed = compiled(spec, path)
    home, reasons["joints"] = _home(keyed)
    base, reasons["base"] = _base(keyed)
    passive = [j.name for j in spec.joints if drives and j.name not in drives and j.type != mujoco.mjtJoint.mjJNT_FREE]
    strip(spec, tuple(passive))
    float_base(spec, base, path)
    model = compiled(spec, path)
    hinges = [j.name for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_HINGE]
    if not hinges:
        raise TrainerError("the model has no joint that could be driven", file=path, expected="hinges")
    home = {name: home[name] for name in hinges}
    feet, reasons["feet"] = _feet(model, in_pose(model, home))
    if not feet:
        raise TrainerError(
            "no pair of feet was found: the robot walks on nothing", file=path, expected=reasons["feet"], found="none",
            hint="in the model x must be ahead and z up (the origin of the first joint can turn it)",
        )  # fmt: skip
    moved = {n: model.body(int(model.jnt_bodyid[model.joint(n).id])).name for n in hinges}
    wheels = [n for n in hinges if not model.jnt_limited[model.joint(n).id] and moved[n] in feet]
    if wheels:
        strip(spec, tuple(wheels))
        model, hinges = compiled(spec, path), [name for name in hinges if name not in wheels]
        if not hinges:
            raise TrainerError("the robot has wheels and no legs", file=path, expected="legs: training makes it walk")
        home = {name: home[name] for name in hinges}
        reasons["lock"] = "wheels (feet that turn without limit): fixed at 0, training drives positions"
    if not keyed.nkey and len(feet) > 2:  # two feet are flat, and stand as they are
        home = _feet_below_hips(model, home, feet)
        if any(home.values()):
            reasons["joints"] = (
                "default: no key frame, so zero, or mid-range where limits exclude zero; feet below hips"
            )
    data = in_pose(model, home)
    servos, limits = {}, _urdf_limits(path)
    load = float(model.body_subtreemass[0]) * 9.81 * standing_height(model, home) / 2
    for name in hinges:
        servos[name], reasons[f"joints.{name}"] = _servo(model, name, home[name], drives.get(name), limits, load)
    torso, reasons["torso"] = _torso(model, base, feet)
    camera, reasons["camera"] = _camera(keyed, model, data, base)
    hips = tuple(hip_joints(data, leg_paths(model, feet)))
    reasons["hips"] = "upper half of each leg, not about y: kept near the default by a reward"
    if passive:
        reasons["lock"] = " ".join(filter(None, ("nothing drives them: fixed at 0.", reasons.get("lock"))))
    mujoco.mj_fwdPosition(model, data)
    exclude = tuple(sorted(touching(model, data)))
    if exclude:
        reasons["exclude"] = "these overlap in the default pose"
    reasons["name"] = "policies and reports call it so"
    file = RobotFile(
        model=os.path.relpath(path.resolve(), out.resolve().parent),
        name=path.stem,
        base=base,
        torso=torso,
        feet=feet,
        joints=servos,
        hips=hips,
        lock=(*passive, *wheels),
        exclude=exclude,
        camera=camera,
    )
    return file, reasons


def _drives(spec: Any, path: Path) -> dict[str, Any]:
    """Joint -> the actuator that drives it.

    Raises:
        TrainerError: an actuator drives something else, as a tendon.
    """
    others = [a.name for a in spec.actuators if a.trntype != mujoco.mjtTrn.mjTRN_JOINT]
    if others:
        raise TrainerError(
            f"actuator {others[0]} drives no joint",
            file=path,
            expected="a servo for each joint",
            found=", ".join(others),
            hint="give each joint that it moves an actuator of its own, in a copy of the model",
        )
    return {a.target: a for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_JOINT}


def _home(model: Any) -> tuple[dict[str, float], str]:
    """Angles of the default pose, and where they are from."""
    hinges = [model.joint(j) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    if model.nkey:
        qpos, why = model.key_qpos[0], f"default: key frame {model.key(0).name or 0!r}"
    else:
        qpos, why = model.qpos0, "default: the model has no key frame, so its zero pose: bend straight legs"
    found = {}
    for joint in hinges:
        angle, (low, high) = float(qpos[joint.qposadr[0]]), joint.range
        if low < high and not low < angle < high:
            angle = float(low + high) / 2
        found[joint.name] = round(angle, 4)
    return found, why


def _feet_below_hips(model: Any, home: dict[str, float], feet: tuple[str, ...]) -> dict[str, float]:
    """The pose with the upper of two joints about y turned until the foot is below it: else the robot falls over."""
    home = dict(home)
    for foot in feet:
        data = in_pose(model, home)
        pitch = [n for n in joints_above(model, foot) if n in home and abs(data.joint(n).xaxis[1]) > _ALONG_Y]
        if len(pitch) != 2:
            continue
        low, high = model.joint(pitch[0]).range if model.joint(pitch[0]).limited else (-np.pi, np.pi)
        off, joint, adr = {}, data.joint(pitch[0]), int(model.joint(pitch[0]).qposadr[0])
        geoms = [g for g in range(model.ngeom) if model.body(foot).id == model.geom_bodyid[g]]
        for angle in np.linspace(max(low, -1.5), min(high, 1.5), 301):
            data.qpos[adr] = angle
            mujoco.mj_kinematics(model, data)
            tip = min((_centre(model, data, g) for g in geoms), key=lambda x: float(x[2]))
            off[abs(float(tip[0] - joint.xanchor[0]))] = round(float(angle), 3)
        home[pitch[0]] = off[min(off)] if off else home[pitch[0]]
    return home


def _centre(model: Any, data: Any, geom: int) -> Any:
    body = int(model.geom_bodyid[geom])
    return data.xpos[body] + data.xmat[body].reshape(3, 3) @ model.geom_pos[geom]


def _base(model: Any) -> tuple[str, str]:
    for j in range(model.njnt):
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            return model.body(int(model.jnt_bodyid[j])).name, "the body with the free joint"
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    heaviest = max(roots, key=lambda b: float(model.body_subtreemass[b]))
    return model.body(heaviest).name, "the root of the tree; it gets a free joint; x is taken to be ahead, z up"


def _feet(model: Any, data: Any) -> tuple[tuple[str, ...], str]:
    """Ends that reach the lowest, in pairs from front to back."""
    lows: dict[int, float] = {}
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        if body and collides(model, g):
            lows[body] = min(lows.get(body, np.inf), lowest(model, data, g))
    if not lows:
        raise TrainerError("the robot has nothing that collides", hint="give its feet geoms with contype 1")
    down = [b for b, z in lows.items() if z < min(lows.values()) + FOOT_M and joints_above(model, model.body(b).name)]
    ends = [b for b in down if not any(_is_above(model, b, other) for other in down if other != b)]
    sides = {
        side: sorted((b for b in ends if (data.xpos[b, 1] > 0) == side), key=lambda b: -data.xpos[b, 0])
        for side in (True, False)
    }
    pairs = [model.body(b).name for pair in zip(sides[True], sides[False], strict=False) for b in pair]
    why = f"colliding ends within {100 * FOOT_M:g} cm of the lowest point; left, right, from front to back"
    if len(sides[True]) != len(sides[False]):
        why += f". Left and right differ ({len(sides[True])} and {len(sides[False])}): correct this"
    return tuple(pairs), why


def _is_above(model: Any, body: int, other: int) -> bool:
    """Whether a body carries another."""
    while other:
        other = int(model.body_parentid[other])
        if other == body:
            return True
    return False


def _servo(
    model: Any, name: str, default: float, actuator: Any, limits: dict[str, dict[str, float]], load: float
) -> tuple[Servo, str]:
    """Gains and limits of a joint, with where each is from."""
    joint, urdf, why = model.joint(name), limits.get(name, {}), []
    gear = abs(float(actuator.gear[0])) if actuator is not None else 1.0
    is_servo = actuator is not None and float(actuator.biasprm[1]) < 0
    if actuator is not None and actuator.forcerange[0] < actuator.forcerange[1]:
        effort = gear * float(actuator.forcerange[1])
        why.append("effort: actuator's force range")
    elif actuator is not None and not is_servo and actuator.ctrlrange[0] < actuator.ctrlrange[1]:
        effort = gear * abs(float(actuator.gainprm[0])) * float(actuator.ctrlrange[1])
        why.append("effort: actuator's control range x gear")
    elif model.jnt_actfrclimited[joint.id]:
        effort = float(model.jnt_actfrcrange[joint.id, 1])
        why.append("effort: the joint's limit")
    else:
        effort = urdf.get("effort") or load
        why.append("effort: the URDF's" if urdf.get("effort") else "effort: nothing says it; weight x half the leg")
    armature, damping = (float(np.ravel(getattr(joint, key))[0]) for key in ("armature", "damping"))
    if is_servo:
        kp, kd = gear * float(actuator.gainprm[0]), -gear * float(actuator.biasprm[2])
        kd = kd or (0.0 if damping else DAMPING_S * kp)
        why.append("gains: the model's servo")
    elif armature > 0:
        kp, kd = pd_gains(armature)
        why.append("gains: 10 Hz with the armature")
    else:
        kp = effort / SAG_RAD
        kd = DAMPING_S * kp
        why.append(f"gains: full torque at {SAG_RAD:g} rad")
    velocity = urdf.get("velocity") or SPEED_RAD_S
    why.append("velocity: the URDF's" if urdf.get("velocity") else "velocity: nothing says it")
    return Servo(default, kp, kd, effort, velocity, 0.25 * effort / kp), "; ".join(why)


def _urdf_limits(path: Path) -> dict[str, dict[str, float]]:
    """{joint: effort and velocity} of a URDF; MuJoCo keeps no speeds."""
    root = ElementTree.parse(path).getroot()
    if root.tag != "robot":
        return {}
    found = {}
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            given = {key: float(limit.get(key, 0)) for key in ("effort", "velocity")}
            found[str(joint.get("name"))] = {key: value for key, value in given.items() if 0 < value < 1e4}
    return found


def _torso(model: Any, base: str, feet: tuple[str, ...]) -> tuple[str, str]:
    if len(feet) > 2:
        return base, "the base of a robot with more than two feet"
    names = [model.body(b).name for b in range(1, model.nbody)]
    named = [n for n in names if any(word in n.lower() for word in ("torso", "chest", "trunk", "waist"))]
    if named:
        heaviest = max(named, key=lambda n: float(model.body(n).mass[0]))
        return heaviest, "named like one; its tilt ends an episode"
    return base, "no body is named like a torso; the base's tilt ends an episode"


def _camera(keyed: Any, model: Any, data: Any, base: str) -> tuple[Mount, str]:
    """The model's first camera that looks ahead along a body, else a mount on the front of the base."""
    for c in range(keyed.ncam):
        body = keyed.body(int(keyed.cam_bodyid[c])).name
        ahead = quat_to_R(keyed.cam_quat[c]) @ LOOK.T @ [1, 0, 0]
        if body != "world" and keyed.cam_mode[c] == 0 and ahead[0] > 0.3 and abs(ahead[1]) < 0.1:
            pitch = round(float(np.degrees(np.arctan2(-ahead[2], ahead[0]))), 2)
            x, y, z = (round(float(v), 4) for v in keyed.cam_pos[c])
            return Mount(body, (x, y, z), pitch, float(keyed.cam_fovy[c])), f"the model's camera {keyed.cam(c).name!r}"
    body = model.body(base).id
    mine = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and collides(model, g)]
    points = [outline(model, g, np.array(d, float)) for g in mine for d in ((1, 0, 0), (0, 0, 1))] or [np.zeros((1, 3))]
    front, _, top = np.vstack(points).max(0)
    at = (round(float(front), 3), 0.0, round(float(top), 3))
    why = "nothing says it: a D435i at front and top of the base. Another mount is another policy"
    return Mount(base, at, CAMERA_PITCH_DEG), why
