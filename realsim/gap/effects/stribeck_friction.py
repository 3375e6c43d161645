"""Friction that is higher at rest and in slow motion."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import LOGGED, Edit, Effect, Excitation, Law, Parameter, Place, Rivals, Suggestion, Words
from realsim.gap.effects.sizes import size_of_dry_friction

WIDEST = 0.4
"""rad/s, well above what gears show: a friction that falls over a wider range of speeds imitates other things."""

HIGHER_AT_REST = 1.05
"""Ratio of friction at rest to friction in motion from which on it is no Coulomb friction."""

DRY = ("coulomb_friction", "friction")
"""To first order it is dry friction, whose slopes cost an eighth; the search goes on from there."""

FINEST = 4
"""A falling friction drives a light joint unstable at a coarse time step, which is divided by up to this."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.friction(j) for j in place)
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.6 * nominal, 0.05 * scale, 1e-4)
    speed = max(context.speed[j] for j in place)
    widest = min(0.4 * speed, WIDEST)
    return (
        Parameter("static_friction", "N m", (0.0, top), step, like=DRY, plausible=size_of_dry_friction(context, place)),
        Parameter("coulomb", "N m", (0.0, top), 0.5 * step, like=DRY),
        Parameter("stribeck_velocity", "rad/s", (0.02 * widest, widest), 0.12 * widest, default=0.3 * widest),
    )


def _excited(context: Context, place: Place) -> Excitation:
    turns = min(context.reversals[j] for j in place)
    return Excitation(turns >= 2, f"the velocity changes sign {turns} times")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Dry friction raised by F at rest, of which C stays in motion: the piecewise-linear Stribeck curve.

    That is friction F minus clip(c v, -(F - C), F - C) with c = (F - C) / v_s.
    """
    static, moving = values["static_friction"], values["coulomb"]
    if static <= HIGHER_AT_REST * moving:
        return  # that is Coulomb friction, which has a name of its own; here it would only be its rival
    falling = static - moving
    for joint in place:
        name = edit.motor_joint(joint)
        edit.add_friction(joint, static)
        wanted = falling / values["stribeck_velocity"]
        stable = 0.4 * edit.context.inertia[joint] / edit.context.timestep
        finer = int(np.clip(np.ceil(wanted / stable), 1, FINEST))
        edit.spec.option.timestep = min(edit.spec.option.timestep, edit.context.timestep / finer)
        slope = min(wanted, finer * stable)
        helper = edit.add_helper(f"stribeck_{joint}", name, slope)
        helper.forcerange, helper.forcelimited = np.array([-falling, falling]), 1


BEGUN = 1.5
"""Ratio of friction at rest to friction in motion to search from: near the law that this one contains. From two and a
half and from three times it, fits stuck at up to 280 nats more (1511/122, 1613/102; not in 1409/161, 1301/128)."""


def higher_at_rest(context: Context, place: Place, moving: float) -> Suggestion:
    """Above the friction in motion: below it, friction at rest does nothing, and no slope leads out of there."""
    usual = next(p.default for p in _parameters(context, place) if p.name == "stribeck_velocity")
    values = {"static_friction": BEGUN * moving, "coulomb": moving, "stribeck_velocity": usual}
    return Suggestion("stribeck_friction", place, values)


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Begun anew near Coulomb friction; and Coulomb friction, which is this without a fall."""
    moving = values.get("coulomb", 0.0) or values["static_friction"]
    return [Suggestion("coulomb_friction", place, {"friction": moving}), higher_at_rest(context, place, moving)]


EFFECT = Effect(
    name="stribeck_friction",
    where=LOGGED,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="Stribeck friction",
        description="Dry friction is higher near rest and falls to its level in motion over the Stribeck velocity.",
        signature="Stick and jerk at slow reversals; fast motion is right.",
        excitation=("very slow motion with reversals beside fast motion",),
        changed_by="wear or lack of grease",
    ),
    excited_by=_excited,
    law=Law(stiff=True),
    rivals=Rivals(suggest=_suggests, special_case="coulomb_friction"),
)
