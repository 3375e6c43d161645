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


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for name in _thrusters(edit.context):
        edit.scale_drive(name, ratio)


EFFECT = Effect(
    name="thrust_gain",
    where=Where("global", lambda context: [()] if _thrusters(context) else []),
    parameters=gain(0.1, 0.015),
    apply=_apply,
    words=Words(
        title="thrust",
        description="All thrusters (actuators on a site or a body) push by a ratio: air density, battery, propellers.",
        signature="Less lift like a mass that is not there, but the turning is slower, too.",
        excitation=("climbing and turning",),
        changed_by="another battery or propeller, another altitude",
    ),
    law=Law(form=EXACT),
)
