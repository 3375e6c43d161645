"""The actuator gives more or less force than commanded."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, JOINTS, Edit, Effect, Excitation, Law, Place, Words, gain


def _excited(context: Context, place: Place) -> Excitation:
    load = context.load(place)
    return Excitation(load > 0.02, f"the drive works at {load:.0%} of its torque range")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        edit.scale_drive(edit.context.actuator[joint], ratio)


EFFECT = Effect(
    name="motor_gain",
    where=JOINTS,
    parameters=gain(0.15, 0.015),
    apply=_apply,
    words=Words(
        title="motor gain",
        description="The whole force of the actuator is scaled (torque constant, supply voltage, gear efficiency).",
        signature="More sag under load and slower response at once: stiffness and damping change by the same ratio.",
        excitation=("load or acceleration",),
        changed_by="a motor that was exchanged, or is hot or weak",
    ),
    excited_by=_excited,
    law=Law(form=EXACT),
)
