"""A mass that the model does not know."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import add_point_mass
from realsim.gap.effects.base import (
    EXACT,
    Distinction,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Where,
    Words,
    always,
)
from realsim.gap.effects.sizes import size_of_mass

REACH = 0.2
"""A tool may hang so far from the body that carries it, m, however small that body is."""
SHARE = 0.3
"""Of the robot's mass: what a light flange may carry at least."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    body = context.case.model.body(place[0])
    mass, total = float(body.mass[0]), context.moved_mass(place[0])
    reach = max(1.3 * context.reach(place[0]), REACH)
    most = max(3 * total, 3 * mass, SHARE * context.total_mass)
    step = max(0.15 * mass, 0.05 * total)
    where = [
        Parameter(
            axis,
            "m",
            (float(c) - reach, float(c) + reach),
            0.05,
            default=float(c),
            shape=True,
            like=("com_offset", axis),
        )
        for axis, c in zip("xyz", body.ipos, strict=True)
    ]
    size = size_of_mass(context, place)
    return (Parameter("mass", "kg", (-0.7 * mass, most), step, nuisance=0.012 * mass, plausible=size), *where)


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A point mass at (x, y, z) in the body's frame; inertia about the new centre of mass (parallel axes)."""
    added = values["mass"]
    if added == 0:
        return
    where = np.array([values[a] for a in "xyz"])
    for name in place:
        body = edit.spec.body(name)
        edit.set_inertia(body, *add_point_mass(*edit.inertia_of(body), added, where))


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The same mass on the links before and behind: near the joint between them, it does the same on either. And what
    it does to the link's own centre of mass: where one joint moves it, the two differ by what the mass weighs."""
    import mujoco

    model, data = context.case.model, mujoco.MjData(context.case.model)
    mujoco.mj_kinematics(model, data)
    here = model.body(place[0])
    at = [values.get(a, c) for a, c in zip("xyz", here.ipos, strict=True)]
    world = data.xpos[here.id] + data.xmat[here.id].reshape(3, 3) @ at
    shift = values["mass"] * (np.array(at) - here.ipos) / (float(here.mass[0]) + values["mass"])
    far, axes = int(np.argmax(np.abs(shift))), dict(zip("xyz", shift.tolist(), strict=True))
    own = [Suggestion("com_offset", place, axes), Suggestion("com_offset", place, {"xyz"[far]: axes["xyz"[far]]})]
    found = own if shift.any() else []
    for name in context.bodies:
        there = model.body(name)
        if there.id == int(here.parentid[0]) or here.id == int(there.parentid[0]):
            local = data.xmat[there.id].reshape(3, 3).T @ (world - data.xpos[there.id])
            moved = {"mass": values["mass"], **dict(zip("xyz", local.tolist(), strict=True))}
            found.append(Suggestion("payload", (name,), moved))
    return found


EFFECT = Effect(
    name="payload",
    where=Where("body", lambda context: [(name,) for name in context.bodies]),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("the body's mass, or its randomisation", "randomize_rigid_body_mass", "the body's mass in the MJCF"),
        title="payload",
        description="A mass fixed to a body at a point (x, y, z in the body's frame).",
        signature="More sag in every pose that carries it, in the joints between it and the base; slower acceleration; "
        "more weight on the feet.",
        excitation=("gravity in several poses",),
        told_by=(Distinction("a constant force", "accelerations"),),
        changed_by="something that was mounted or removed",
        sort="thing",
        comparatives=("lighter", ""),
    ),
    excited_by=always("gravity and acceleration act on it"),
    variants=(("mass",), ("mass", "x", "y", "z")),  # the link's own, or something that sits elsewhere on it
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests),
)
