"""The velocity gain of the servo differs."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import (
    EXACT,
    JOINTS,
    Distinction,
    Edit,
    Effect,
    Excitation,
    Law,
    Place,
    Rivals,
    Suggestion,
    Words,
    gain,
    servo_damping,
)


def _excited(context: Context, place: Place) -> Excitation:
    speed = max(context.speed[j] for j in place)
    torque = context.case.command_kind == "torque"
    return Excitation(not torque and speed > 0.02, f"peak speed {speed:.2g} rad/s")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        if edit.context.case.command_kind == "velocity":
            put(actuator, "gainprm", 0, actuator.gainprm[0] * ratio)
        put(actuator, "biasprm", 2, actuator.biasprm[2] * ratio)


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Viscous friction brakes like the servo; only the drive's torque, or its limit, tells them apart."""
    if context.case.has("joint_torque"):
        return []
    damping = math.expm1(values["ratio"]) * servo_damping(context, place)
    return [Suggestion("viscous_friction", place, {"damping": damping})]


EFFECT = Effect(
    name="damping_gain",
    where=JOINTS,
    parameters=gain(0.25, 0.03),
    apply=_apply,
    words=Words(
        settings=("damping of the actuator", "damping of the actuator", "damping in deploy.yaml"),
        title="damping gain (kd)",
        description="The servo turns velocity into torque with another gain than the model's.",
        signature="Lag in proportion to speed, both ways; overshoot after steps; shows in the drive's torque, "
        "unlike viscous friction.",
        excitation=("fast motion",),
        told_by=(Distinction("viscous friction", "measured torque", ("joint_torque",)),),
        changed_by="a servo that was exchanged or set otherwise",
    ),
    excited_by=_excited,
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests),
)
