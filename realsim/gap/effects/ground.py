"""Friction, give and place of what the robot stands on."""

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import (
    EVERYWHERE,
    EXACT,
    GROUND,
    SUPPORTS,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Where,
    Words,
    always,
    fixed,
    on_the_ground,
    relative,
)


def _apply_ground_friction(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for geom in edit.spec.geoms:
        put(geom, "friction", 0, geom.friction[0] * (1 + values["ratio"]))


GROUND_FRICTION = Effect(
    name="ground_friction",
    where=GROUND,
    parameters=relative((-0.92, 2.0), -0.4, 0.1),
    apply=_apply_ground_friction,
    words=Words(
        settings=("friction of feet and terrain", "physics_material of the terrain", "friction in the MJCF"),
        title="ground friction",
        description="The sliding friction coefficient of all contacts is scaled.",
        signature="Feet slide where the model's stick (or the reverse): base position and yaw drift under shear load.",
        excitation=("shear forces near the friction limit",),
        changed_by="another floor or worn feet",
    ),
    excited_by=on_the_ground,
    law=Law(abrupt=True),
)


def _apply_contact_compliance(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for body in [edit.spec.worldbody, *(edit.spec.body(b) for b in edit.context.terrain)]:
        for geom in body.geoms:
            if geom.solref[0] > 0:
                put(geom, "solref", 0, max(geom.solref[0] + values["time_constant"], 2 * edit.context.timestep))


CONTACT_COMPLIANCE = Effect(
    name="contact_compliance",
    where=GROUND,
    parameters=fixed(Parameter("time_constant", "s", (-0.006, 0.3), 0.02, nuisance=0.0015)),
    apply=_apply_contact_compliance,
    words=Words(
        title="contact compliance",
        description="The time constant of the ground's contact (MuJoCo's solref) is larger: a mat, grass, rubber feet.",
        signature="Softer touchdown, the base sinks and sways with the load; joints are right.",
        excitation=("load changes and touchdowns",),
        changed_by="another floor or worn feet",
    ),
    excited_by=on_the_ground,
    law=Law(stiff=True),
)


def _apply_terrain_height(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        body.pos = np.asarray(body.pos) + np.array([0.0, 0.0, values["height"]])


TERRAIN_HEIGHT = Effect(
    name="terrain_height",
    where=SUPPORTS,
    parameters=fixed(Parameter("height", "m", (-0.1, 0.1), 0.01, nuisance=0.0012)),
    apply=_apply_terrain_height,
    words=Words(
        title="terrain height",
        description="A piece of terrain stands higher or lower by a constant.",
        signature="From the first moment the leg on it is more or less loaded, and the base leans.",
        excitation=("standing on it, with base pose, IMU or joint positions under load",),
        sort="direction",
        comparatives=("lower", "higher"),
    ),
    excited_by=on_the_ground,
    law=Law(form=EXACT, abrupt=True),
)


def _apply_terrain_scale(edit: Edit, place: Place, values: dict[str, float]) -> None:
    import mujoco

    ratio = 1 + values["ratio"]
    for name in edit.context.terrain:
        body = edit.spec.body(name)
        body.pos = np.asarray(body.pos) * ratio
        for geom in body.geoms:
            geom.pos = np.asarray(geom.pos) * ratio
            if geom.type != mujoco.mjtGeom.mjGEOM_PLANE:
                geom.size = np.asarray(geom.size) * ratio
            fromto = np.asarray(geom.fromto)
            if np.isfinite(fromto).all():
                geom.fromto = fromto * ratio


TERRAIN_SCALE = Effect(
    name="terrain_scale",
    where=Where("global", lambda context: [()] if context.terrain else []),
    parameters=relative((-0.5, 1.0), 0.1, 0.005),
    apply=_apply_terrain_scale,
    words=Words(
        title="terrain scale",
        description="All terrain but the ground plane is scaled about the world's origin: a wrong metric scale.",
        signature="All steps are too high or too low by the same ratio.",
        excitation=("standing on several heights",),
    ),
    excited_by=on_the_ground,
    law=Law(form=EXACT),
)


def _parameters_terrain_tilt(context: Context, place: Place) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, "rad", (-0.4, 0.4), 0.04, nuisance=0.002) for name in ("roll", "pitch"))


def _apply_terrain_tilt(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A floating robot stands on turned ground; for a fixed base, gravity turns the other way in the base's frame."""
    turn = rotation(values["roll"], values["pitch"])
    if not edit.context.case.floating:
        edit.spec.option.gravity = turn.T @ np.asarray(edit.spec.option.gravity)
        return
    # Bodies that stand in the world, not the parts that they carry, which turn with them.
    fixed = [not body.joints for body in edit.context.spec.worldbody.bodies]
    bodies = [b for b, f in zip(edit.spec.worldbody.bodies, fixed, strict=False) if f]  # rotors come after these
    for item in [*edit.spec.worldbody.geoms, *bodies]:
        item.pos = turn @ item.pos
        item.quat = multiply(quaternion(values["roll"], values["pitch"]), item.quat)


def rotation(roll: float, pitch: float) -> F64:
    """(3, 3) about the fixed axes, first x then y."""
    c, s, d, t = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return np.asarray(np.array([[d, 0, t], [0, 1, 0], [-t, 0, d]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]))


def quaternion(roll: float, pitch: float) -> F64:
    """w x y z of `rotation`."""
    x = np.array([np.cos(roll / 2), np.sin(roll / 2), 0, 0])
    return multiply(np.array([np.cos(pitch / 2), 0, np.sin(pitch / 2), 0]), x)


def multiply(p: F64, q: F64) -> F64:
    """Hamilton product of w x y z quaternions."""
    w, v, a, u = p[0], np.asarray(p[1:]), q[0], np.asarray(q[1:])
    return np.concatenate([[w * a - v @ u], w * u + a * v + np.cross(v, u)])


TERRAIN_TILT = Effect(
    name="terrain_tilt",
    where=EVERYWHERE,
    parameters=_parameters_terrain_tilt,
    apply=_apply_terrain_tilt,
    words=Words(
        title="terrain tilt",
        description="The ground as a whole is tilted about the world's x and y axes (for a fixed base: its mount).",
        signature="The base leans by the tilt in every pose; uphill and downhill legs carry different loads.",
        excitation=("standing", "base pose or IMU"),
        sort="direction",
    ),
    excited_by=always("gravity shows it"),
    variants=(("roll",), ("pitch",), ("roll", "pitch")),
    law=Law(form=EXACT, footing=("roll", "pitch")),
)


def _parameters_terrain_wobble(context: Context, place: Place) -> tuple[Parameter, ...]:
    weight = 9.81 * context.total_mass
    soft, rock = 0.02 / weight, 0.15 / (0.05 * weight)
    return (
        Parameter("stiffness", "N/m", (0.0, 12 * soft), soft, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("tilt_stiffness", "N m/rad", (0.0, 12 * rock), rock, report=lambda z: 1 / max(z, 1e-9)),
        Parameter("relaxation", "s", (0.002, 0.5), 0.02, default=0.03),
    )


def _apply_terrain_wobble(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Springs at the support's centre: up and down (`stiffness`) or about x and y (`tilt_stiffness`).

    The damper is given by the relaxation time: damping = relaxation * stiffness.
    """
    import mujoco

    for name in place:
        body = edit.spec.body(name)
        body.gravcomp = 1.0  # the support rests in its place without the robot
        if values["stiffness"] > 0:
            k = 1 / values["stiffness"]
            edit.add_spring_joint(
                body, f"{name}_sink", mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1], k, k * values["relaxation"]
            )
        if values["tilt_stiffness"] > 0:
            k = 1 / values["tilt_stiffness"]
            for label, axis in (("roll", [1, 0, 0]), ("pitch", [0, 1, 0])):
                edit.add_spring_joint(
                    body, f"{name}_{label}", mujoco.mjtJoint.mjJNT_HINGE, axis, k, k * values["relaxation"]
                )


TERRAIN_WOBBLE = Effect(
    name="terrain_wobble",
    where=SUPPORTS,
    parameters=_parameters_terrain_wobble,
    apply=_apply_terrain_wobble,
    words=Words(
        title="wobbling support",
        description="A support sinks or rocks on a spring and damper when it is loaded.",
        signature="The base sinks and leans toward a leg as load moves onto it, and swings after load changes.",
        excitation=("load moving on and off that support",),
        sort="thing",
    ),
    excited_by=on_the_ground,
    variants=(("stiffness", "relaxation"), ("tilt_stiffness", "relaxation")),
    law=Law(abrupt=True),
)
