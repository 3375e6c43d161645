"""A body's rotational inertia differs."""

from dataclasses import replace

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EXACT,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    Words,
    always,
    heavy_bodies,
    relative,
)
from realsim.gap.effects.sizes import size_of_inertia

MOST, LEAST = 6.0, 0.3
"""Share by which it may be more, and by which it may be whatever the body's shape is: published ones of a Crazyflie
differ by 0.4."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    """Up to all of its mass lying as far out as the body reaches, where the three sum to twice m r^2."""
    body = context.case.model.body(place[0])
    shell = 2 * float(body.mass[0]) * context.reach(place[0]) ** 2 / max(float(body.inertia.sum()), 1e-12)
    ratio = relative((-0.85, float(np.clip(shell - 1, LEAST, MOST))), 0.6, 0.03)
    return tuple(replace(p, plausible=size_of_inertia(context, place)) for p in ratio(context, place))


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com, inertia * (1 + values["ratio"]))


EFFECT = Effect(
    name="link_inertia",
    where=heavy_bodies(0.015),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="link inertia",
        description="The inertia tensor of a body is scaled; mass and centre of mass stay.",
        signature="Error in proportion to angular acceleration of that link, whatever joint turns it; none at rest.",
        excitation=("fast angular acceleration about several axes",),
        changed_by="a part that was exchanged",
    ),
    excited_by=always("angular acceleration shows it"),
    law=Law(form=EXACT),
    rivals=Rivals(commoner="armature"),  # a drawing tells a link's inertia, but not a rotor's
)
