"""A robot of one's own: a small file beside its model. `realsim robot new` guesses it, a person corrects it."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from realsim.core.files import read_text
from realsim.core.geometry import R_to_quat, quat_to_R
from realsim.core.mjcf import check_mjcf, find_packages
from realsim.core.progress import note
from realsim.core.types import F64
from realsim.robots.base import Robot, add_camera, add_servo
from trainer.errors import TrainerError
from trainer.fields import filled
from trainer.robots.base import TrainedRobot
from trainer.robots.derive import derived
from trainer.robots.soles import collides, outline

SOLE_M = 0.01
"""Collision geoms of a foot's body whose lowest point is at most this much above the lowest of all are the foot."""
_WAY_OUT = {
    "passive": "drive it with an actuator, or write its name into `lock`: it is then fixed at 0",
    "loop": "training simulates trees: leave the rods out of a copy of the model, and give each joint of the leg the "
    "actuator that moves it through them",
}


@dataclass(frozen=True)
class Servo:
    """One joint with its position servo."""

    default: float
    """rad: the pose that action 0 asks for."""
    kp: float
    """N m/rad."""
    kd: float
    """N m s/rad."""
    effort: float
    """N m."""
    velocity: float
    """rad/s of the motor."""
    action_scale: float
    """rad a unit of action."""


@dataclass(frozen=True)
class Mount:
    """A depth camera on a body, that looks along the body's x axis, pitched down."""

    body: str
    pos: tuple[float, float, float]
    """(3,) m in the body's frame."""
    pitch_deg: float
    fovy_deg: float = 58.0


@dataclass(frozen=True)
class RobotFile:
    """What the file says; names are the model's."""

    model: str
    """MJCF or URDF, relative to the file."""
    name: str
    base: str
    torso: str
    feet: tuple[str, ...]
    """Bodies: left, right, left, right."""
    joints: dict[str, Servo]
    """Actuated hinges."""
    hips: tuple[str, ...] = ()
    lock: tuple[str, ...] = ()
    """Joints that are taken out: fixed at 0."""
    exclude: tuple[tuple[str, ...], ...] = ()
    """Pairs of bodies that do not collide with each other."""
    camera: Mount | None = None

    def text(self, reasons: Mapping[str, str]) -> str:
        """TOML, a reason beside every line that has one."""
        top = {k: v for k, v in asdict(self).items() if k not in ("joints", "camera")}
        lines = [_line(key, json.dumps(value), reasons.get(key)) for key, value in top.items()]
        if self.camera is not None:
            lines += ["", _line("[camera]", "", reasons.get("camera"))]
            lines += [f"{key} = {json.dumps(value)}" for key, value in asdict(self.camera).items()]
        lines += ["", _line("[joints]", "", reasons.get("joints"))]
        for name, servo in self.joints.items():
            figures = ", ".join(f"{key} = {value:.5g}" for key, value in asdict(servo).items())
            lines.append(_line(json.dumps(name), f"{{{figures}}}", reasons.get(f"joints.{name}")))
        return "\n".join(lines) + "\n"


def _line(key: str, value: str, reason: str | None) -> str:
    return f"{key} = {value}".removesuffix(" = ") + (f"  # {reason}" if reason else "")


def read(path: Path) -> RobotFile:
    """The file, checked for what it must hold.

    Raises:
        TrainerError: no TOML, an entry that is missing, unknown or of another kind.
    """
    try:
        data = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        expected = f"TOML with {', '.join(f.name for f in fields(RobotFile))}"
        hint = "realsim robot new MODEL writes one"
        raise TrainerError("not a robot's file", file=path, expected=expected, found=str(error), hint=hint) from error
    found = filled(RobotFile, data, "entry of a robot's file", path)
    for name, servo in found.joints.items():
        if min(servo.kp, servo.effort, servo.velocity, servo.action_scale) <= 0 or servo.kd < 0:
            expected = "gains, limits and scales that are positive numbers"
            raise TrainerError(f"joint {name} cannot be driven so", file=path, expected=expected, found=str(servo))
    return found


def load(path: Path) -> TrainedRobot:
    """The robot that a file describes.

    Raises:
        TrainerError: file and model do not fit together, or the model is one that cannot be trained.
    """
    file = read(path)
    model = path.parent / file.model
    spec = opened(model)
    strip(spec, file.lock)
    _refuse_what_is_missing(spec, file, path)
    _refuse_what_cannot_be_simulated(spec, file, model)
    order = [j.name for j in spec.joints if j.name in file.joints]
    for name in order:
        _add_servo(spec, name, file.joints[name])
    for pair in file.exclude:
        spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])
    float_base(spec, file.base, model)
    home = {name: servo.default for name, servo in file.joints.items()}
    feet = split_feet(spec, file.feet, home, model)
    if file.camera is not None:
        mount = file.camera
        add_camera(spec.body(mount.body), "depth", mount.pos, np.radians(mount.pitch_deg), mount.fovy_deg)
    height = standing_height(compiled(spec, model), home)
    spec.body(file.base).pos, spec.body(file.base).quat = [0, 0, height], [1, 0, 0, 0]
    return derived(
        Robot(file.name, spec, file.base, height, home),
        feet,
        np.array([file.joints[name].velocity for name in order]),
        torso=file.torso,
        action_scale=np.array([file.joints[name].action_scale for name in order]),
        hips=file.hips,
    )


# ---------------------------------------------------------------- the model


def opened(path: Path) -> Any:
    """`mujoco.MjSpec` of a model whose joints and bodies all have names.

    Raises:
        TrainerError: it cannot be read, or grows without bound; what MuJoCo says of it.
    """
    check_mjcf(path, problem=TrainerError, plugins=True)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise TrainerError(
            "MuJoCo cannot read the model", file=path, expected="MJCF or URDF", found=str(error).splitlines()[0]
        ) from error
    spec.compiler.fusestatic = False  # URDF: its first link would become part of the world
    find_packages(spec, path)
    for kind, items in (("body", spec.bodies[1:]), ("joint", spec.joints)):
        for k, item in enumerate(items):
            item.name = item.name or f"{kind}{k}"
    _inertia_of_shapes(spec)
    return spec


def _inertia_of_shapes(spec: Any) -> None:
    """Bodies of a URDF that give a mass and zeros for its inertia get that of their shapes, as simulators do that
    take inertia from shapes anyway (PyBullet)."""
    bare = [b for b in spec.bodies[1:] if b.explicitinertial and b.geoms and b.mass > 0 and _is_zero(b)]
    if not bare:
        return
    shapes = spec.copy()
    for body in bare:
        shapes.body(body.name).explicitinertial, shapes.body(body.name).ipos = False, [np.nan] * 3
    model = compiled(shapes)
    for body in bare:
        shape = model.body(body.name)
        body.inertia, body.iquat = shape.inertia * body.mass / shape.mass[0], shape.iquat
    names = ", ".join(body.name for body in bare)
    note(f"inertia of {names}: from their shapes, the model gives a mass and zeros")


def _is_zero(body: Any) -> bool:
    return not (np.any(body.inertia) or np.any(np.nan_to_num(body.fullinertia)))


def compiled(spec: Any, path: Path | None = None) -> Any:
    """The compiled model.

    Raises:
        TrainerError: bodies without mass, a mesh that is not there, anything else that MuJoCo refuses.
    """
    try:
        return spec.copy().compile()
    except ValueError as error:
        text = " ".join(str(error).split())
        hint = None
        if "mjMINVAL" in text:
            bare = [b.name for b in spec.bodies[1:] if b.joints and not (b.explicitinertial or b.geoms)]
            text = f"no mass on {', '.join(bare) or 'a moving body'} ({text})"
            hint = "give it an <inertial>, or a geom with a mass; what MuJoCo drops of a URDF (visual) has none"
        elif "balanceinertia" in text:
            hint = 'correct its inertia, or add <mujoco><compiler balanceinertia="true"/></mujoco> to the model'
        elif "mesh" in text or "file" in text.lower():
            hint = "put its meshes where the model looks for them, or take out those that are only drawn"
        raise TrainerError("MuJoCo cannot build the model", file=path, found=text, hint=hint) from error


def strip(spec: Any, lock: tuple[str, ...] = ()) -> None:
    """Take out what is not the robot's body: the ground, actuators, sensors, key frames, cameras; and locked joints."""
    gone = [*spec.sensors, *spec.actuators, *spec.keys, *spec.cameras, *spec.worldbody.geoms, *spec.lights]
    tied = {*lock, *(t.name for t in spec.tendons)}
    gone += [*spec.tendons, *(e for e in spec.equalities if {e.name1, e.name2} & tied)]
    for item in [*gone, *(j for j in spec.joints if j.name in lock)]:
        spec.delete(item)


def float_base(spec: Any, base: str, path: Path) -> None:
    """Give the base its free joint, if it has none."""
    joints = spec.body(base).joints
    held = [j.name for j in joints if j.type != mujoco.mjtJoint.mjJNT_FREE]
    if held:
        raise TrainerError(
            f"the base {base} is held by joints", file=path, expected="a free joint or none: training makes it walk",
            found=", ".join(held), hint="take them out of the model of a robot with legs; an arm is not trained",
        )  # fmt: skip
    if not joints:
        spec.body(base).add_freejoint(name="floating_base")


def standing_height(model: Any, home: dict[str, float]) -> float:
    """Metres from the lowest colliding point to the base, in a pose, the base level."""
    data = in_pose(model, home)
    lows = [lowest(model, data, g) for g in range(model.ngeom) if model.geom_bodyid[g] and collides(model, g)]
    if not lows:
        raise TrainerError("the robot has nothing that collides", hint="give its feet geoms with contype 1")
    return float(-min(lows))


def in_pose(model: Any, home: dict[str, float]) -> Any:
    """`MjData` with the base at the origin, level, and joints at these angles (rad)."""
    data = mujoco.MjData(model)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    for name, angle in home.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return data


def lowest(model: Any, data: Any, geom: int) -> float:
    """z of a geom's lowest point, metres."""
    body = int(model.geom_bodyid[geom])
    R = data.xmat[body].reshape(3, 3)
    return float((data.xpos[body] + outline(model, geom, -R[2]) @ R.T)[:, 2].min())


def split_feet(spec: Any, bodies: tuple[str, ...], home: dict[str, float], path: Path) -> tuple[str, ...]:
    """Names of bodies that are feet only, level in the pose; made where a foot is a geom of a shank."""
    model = compiled(spec, path)
    data = in_pose(model, home)
    return tuple(_split(spec, model, data, name) for name in bodies)


def _split(spec: Any, model: Any, data: Any, name: str) -> str:
    body = model.body(name).id
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and collides(model, g)]
    if not geoms:
        raise TrainerError(f"foot {name} has nothing that collides", hint="name a body whose geoms have contype 1")
    heights = [lowest(model, data, g) for g in geoms]
    soles = [g for g, z in zip(geoms, heights, strict=True) if z < min(heights) + SOLE_M]
    R = data.xmat[body].reshape(3, 3)
    if len(soles) == len(geoms) and np.allclose(R, np.eye(3), atol=1e-3):
        return name
    mine = spec.body(name)
    owned = [g for g in mine.geoms if g.contype or g.conaffinity]  # in the order of the compiled model
    at = np.mean([model.geom_pos[g] for g in soles], axis=0)
    foot = mine.add_body(name=f"{name}_foot", pos=at, quat=R_to_quat(R.T))
    for g in soles:
        _move(spec, owned[geoms.index(g)], model, g, foot, at, R, keeps_mass=not mine.explicitinertial)
    return f"{name}_foot"


def _move(spec: Any, old: Any, model: Any, geom: int, foot: Any, at: F64, R: F64, *, keeps_mass: bool) -> None:
    """Give a geom of the shank to the foot's body, whose axes are the world's (R: shank to world)."""
    turn, centre = quat_to_R(model.geom_quat[geom]), model.geom_pos[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:  # MuJoCo puts a mesh's frame into its centre of mass
        mesh = model.geom_dataid[geom]
        turn = turn @ quat_to_R(model.mesh_quat[mesh]).T
        centre = centre - turn @ model.mesh_pos[mesh]
    kept = ("friction", "solref", "solimp", "condim", "contype", "conaffinity", "group", "rgba", "margin", "gap")
    new = foot.add_geom(
        type=old.type,
        size=model.geom_size[geom] if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH else [0, 0, 0],
        meshname=old.meshname,
        pos=R @ (centre - at),
        quat=R_to_quat(R @ turn),
        **{key: getattr(old, key) for key in (*kept, "priority", "density", "mass")},
    )
    if not keeps_mass:
        new.mass = 0.0
    name = old.name
    spec.delete(old)
    new.name = name


def _add_servo(spec: Any, name: str, servo: Servo) -> None:
    joint = spec.joint(name)
    joint.actfrclimited = False  # the servo has the limit
    if not joint.range[0] < joint.range[1]:
        turn = 180.0 if spec.compiler.degree else np.pi
        joint.range, joint.limited = [-turn, turn], True
    add_servo(spec, name, servo.kp, servo.kd, servo.effort)


def _refuse_what_is_missing(spec: Any, file: RobotFile, path: Path) -> None:
    bodies, joints = [b.name for b in spec.bodies], [j.name for j in spec.joints]
    camera = (file.camera.body,) if file.camera else ()
    named = [(n, bodies, "body") for n in (file.base, file.torso, *file.feet, *sum(file.exclude, ()), *camera)]
    for name, known, kind in [*named, *((n, joints, "joint") for n in (*file.joints, *file.hips))]:
        if name not in known:
            raise TrainerError(
                f"the model has no {kind} {name}", file=path, expected=f"one of {', '.join(filter(None, known))}"
            )
    if len(file.feet) < 2 or len(file.feet) % 2:
        raise TrainerError(
            "feet come in pairs", file=path, expected="left, right, left, right", found=", ".join(file.feet) or "none"
        )


def _refuse_what_cannot_be_simulated(spec: Any, file: RobotFile, model: Path) -> None:
    loops = [e for e in spec.equalities if e.name1 or e.name2]
    if loops:
        pairs = ", ".join(f"{e.name1}-{e.name2}" for e in loops)
        raise TrainerError(
            "the robot has closed chains or coupled joints", file=model, found=pairs, hint=_WAY_OUT["loop"]
        )
    for joint in spec.joints:
        kind = joint.type
        if kind == mujoco.mjtJoint.mjJNT_FREE or (joint.name in file.joints and kind == mujoco.mjtJoint.mjJNT_HINGE):
            continue
        what = "is no hinge" if kind != mujoco.mjtJoint.mjJNT_HINGE else "has no servo in the file"
        raise TrainerError(f"joint {joint.name} {what}", file=model, hint=_WAY_OUT["passive"])
