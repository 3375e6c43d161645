"""Rotors, propellers or jets give more or less thrust than the model's."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EXACT,
    Distinction,
    Edit,
    Effect,
    Law,
    Place,
    Rivals,
    Suggestion,
    Where,
    Words,
    gain,
)

TRANSMISSION_SITE = 4
"""mjTRN_SITE"""


def thrusters(context: Context) -> list[str]:
    """Actuators that push a site or a body instead of turning a joint."""
    import mujoco

    model, pushing = context.case.model, (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_BODY)
    names = context.case.actuator_names
    return [n for n in names if model.actuator_trntype[model.actuator(n).id] in [int(t) for t in pushing]]


def _places(context: Context) -> list[Place]:
    """All together (a battery, thin air), and each (a propeller)."""
    names = thrusters(context)
    return [(), *((name,) for name in names)] if names else []


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place or thrusters(edit.context):
        edit.scale_drive(name, math.exp(values["ratio"]))


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """A weight beside a rotor that gives less: in a hover both ask more of it, and differ in how the robot turns about
    the rotor's axis alone."""
    if len(place) != 1 or values["ratio"] >= 0:
        return []
    model, i = context.case.model, context.case.model.actuator(place[0]).id
    if model.actuator_trntype[i] != TRANSMISSION_SITE:
        return []
    site = model.site(int(model.actuator_trnid[i, 0]))
    body = model.body(int(site.bodyid[0])).name
    mass = context.total_mass / len(thrusters(context)) * -math.expm1(values["ratio"])
    return [Suggestion("payload", (body,), {"mass": mass, **dict(zip("xyz", map(float, site.pos), strict=True))})]


EFFECT = Effect(
    name="thrust_gain",
    where=Where("actuator", _places),
    parameters=gain(0.1, 0.015),
    apply=_apply,
    words=Words(
        title="thrust",
        description="A thruster (an actuator on a site or a body), or all, push by a ratio: propeller, battery, air.",
        signature="Less lift like a mass that is not there, but the turning is slower, too; of one rotor, a lean.",
        excitation=("climbing and turning",),
        told_by=(Distinction("a payload", "quick turns, or a weighing"),),
        changed_by="another battery or propeller, another altitude",
    ),
    law=Law(form=EXACT),
    rivals=Rivals(_suggests, compared=("payload",)),
)
