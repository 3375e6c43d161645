"""The ground (or the mount of a fixed base) is not level."""

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EVERYWHERE, EXACT, Edit, Effect, Law, Parameter, Place, Words, always


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, "rad", (-0.4, 0.4), 0.04, nuisance=0.002) for name in ("roll", "pitch"))


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
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


EFFECT = Effect(
    name="terrain_tilt",
    where=EVERYWHERE,
    parameters=_parameters,
    apply=_apply,
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
