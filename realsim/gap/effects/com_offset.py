"""A body's centre of mass lies elsewhere."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Law, Parameter, Place, Words, always, heavy_bodies

EVERYDAY = 0.02
"""Share of a small body's reach by which its centre of mass is usually off: a drone of 46 mm is not off by 1.5. Not
tuned."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    reach = context.reach(place[0])
    everyday = min(0.0015, EVERYDAY * reach)
    return tuple(Parameter(axis, "m", (-reach, reach), 0.02, nuisance=everyday) for axis in "xyz")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    shift = np.array([values[a] for a in "xyz"])
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com + shift, inertia)


EFFECT = Effect(
    name="com_offset",
    where=heavy_bodies(0.015),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=(
            "the body's com, or its randomisation",
            "randomize_rigid_body_com",
            "the body's inertial pos in the MJCF",
        ),
        title="centre of mass",
        description="The centre of mass of a body is shifted in the body's frame; mass and inertia stay.",
        signature="A torque that turns with the pose; on a floating base, weight moves from some feet to others.",
        excitation=("several poses under gravity",),
        changed_by="something that was moved",
        sort="direction",
    ),
    excited_by=always("gravity acts on it"),
    variants=(("x",), ("y",), ("z",), ("x", "y", "z")),
    law=Law(form=EXACT),
)
