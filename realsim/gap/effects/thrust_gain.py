"""Rotors, propellers or jets give more or less thrust than the model's."""

from __future__ import annotations

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Parameter, Place, always, gain


def _thrusters(context: Context) -> list[str]:
    """Actuators that push a site or a body instead of turning a joint."""
    import mujoco

    model, pushing = context.case.model, (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_BODY)
    names = context.case.actuator_names
    return [n for n in names if model.actuator_trntype[model.actuator(n).id] in [int(t) for t in pushing]]


def _places(context: Context) -> list[Place]:
    return [()] if _thrusters(context) else []


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (gain(0.1, nuisance=0.015),)


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for name in _thrusters(edit.context):
        edit.scale_drive(name, ratio)


EFFECT = Effect(
    name="thrust_gain",
    title="thrust",
    scope="global",
    description="All thrusters (actuators on a site or a body) push by a ratio: air density, battery, propellers.",
    signature="Less lift like a mass that is not there, but the turning is slower, too.",
    excitation="Climbing and turning.",
    changed_by="another battery or propeller, another altitude",
    places=_places,
    parameters=_parameters,
    excited_by=always,
    apply=_apply,
    form=EXACT,
)
