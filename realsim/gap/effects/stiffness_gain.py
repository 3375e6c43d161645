"""The position gain of the servo differs."""

from __future__ import annotations

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, JOINTS, Edit, Effect, Excitation, Law, Place, Words, gain


def _excited(context: Context, place: Place) -> Excitation:
    position = context.case.command_kind == "position"
    return Excitation(position, "a position servo" if position else "the servo has no position gain")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        gain, bias = actuator.gainprm, actuator.biasprm
        gain[0], bias[1] = gain[0] * ratio, bias[1] * ratio
        actuator.gainprm, actuator.biasprm = gain, bias


EFFECT = Effect(
    name="stiffness_gain",
    where=JOINTS,
    parameters=gain(0.15, 0.015),
    apply=_apply,
    words=Words(
        settings=("stiffness of the actuator", "stiffness of the actuator", "stiffness in deploy.yaml"),
        title="stiffness gain (kp)",
        description="The servo turns position error into torque with another gain than the model's.",
        signature="Steady position error under load scales with 1/ratio; fast motion changes less than by motor gain.",
        excitation=("load at rest or slow motion",),
        changed_by="a servo that was exchanged or set otherwise",
    ),
    excited_by=_excited,
    law=Law(form=EXACT),
)
