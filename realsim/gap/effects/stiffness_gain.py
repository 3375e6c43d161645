"""The position gain of the servo differs."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import EXACT, JOINTS, Edit, Effect, Excitation, Law, Place, Words, gain


def _excited(context: Context, place: Place) -> Excitation:
    position = context.case.command_kind == "position"
    return Excitation(position, "a position servo" if position else "the servo has no position gain")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        put(actuator, "gainprm", 0, actuator.gainprm[0] * ratio)
        put(actuator, "biasprm", 1, actuator.biasprm[1] * ratio)


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
