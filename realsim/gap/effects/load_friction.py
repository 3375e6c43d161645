"""Dry friction in proportion to the transmitted torque."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    JOINTS,
    Edit,
    Effect,
    Excitation,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Words,
    fixed,
)


def _excited(context: Context, place: Place) -> Excitation:
    load, turns = context.load(place), min(context.reversals[j] for j in place)
    return Excitation(load > 0.02 and turns >= 1, f"load {load:.0%} of the range, {turns} reversals")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """MuJoCo's dry friction is constant: the loop that steps the model changes it (realsim.gap.simulation.stepping)."""
    for joint in place:
        edit.signals.load_friction[joint] = edit.signals.load_friction.get(joint, 0.0) + values["ratio"]
        added = max(values["ratio"], 0.0) * edit.context.torque_scale(joint)
        if added:
            edit.stiffen_friction(joint, added / (edit.context.friction(joint) + added))


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """On a joint that holds or lifts, friction of r times the torque acts as a drive that is weaker by 1 + r; where the
    load changes little, as friction that does not depend on it."""
    weaker = {"ratio": -math.log1p(values["ratio"])}
    constant = {"friction": values["ratio"] * context.usual_torque(place)}
    found = [Suggestion("stiffness_gain", place, weaker), Suggestion("motor_gain", place, weaker)]
    return [*found, Suggestion("coulomb_friction", place, constant)]


EFFECT = Effect(
    name="load_friction",
    where=JOINTS,
    parameters=fixed(Parameter("ratio", "ratio", (-0.05, 0.8), 0.1, nuisance=0.01)),
    apply=_apply,
    words=Words(
        title="load-dependent friction",
        description="Gear friction that grows with the torque that the gear carries: a ratio of its size.",
        signature="Like Coulomb friction, but larger where the load is; lifting and lowering differ, an unloaded joint "
        "is right.",
        excitation=("the same motion under different loads",),
        changed_by="wear of the gear",
        ratio_of="the drive's torque",
    ),
    excited_by=_excited,
    patchable=False,
    law=Law(stepwise=True),
    rivals=Rivals(suggest=_suggests, compared=("stiffness_gain", "motor_gain")),
)
