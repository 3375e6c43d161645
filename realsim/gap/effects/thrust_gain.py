"""Rotors, propellers or jets give more or less thrust than the model's."""

from __future__ import annotations

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Law, Place, Where, Words, gain


def _thrusters(context: Context) -> list[str]:
    """Actuators that push a site or a body instead of turning a joint."""
    import mujoco

    model, pushing = context.case.model, (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_BODY)
    names = context.case.actuator_names
    return [n for n in names if model.actuator_trntype[model.actuator(n).id] in [int(t) for t in pushing]]


def _places(context: Context) -> list[Place]:
    """All together (a battery, thin air), and each (a propeller)."""
    names = _thrusters(context)
    return [(), *((name,) for name in names)] if names else []


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place or _thrusters(edit.context):
        edit.scale_drive(name, math.exp(values["ratio"]))


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
        changed_by="another battery or propeller, another altitude",
    ),
    law=Law(form=EXACT),
)
