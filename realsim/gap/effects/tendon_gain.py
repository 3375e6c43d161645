"""A drive that pulls a tendon gives more or less force than commanded."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Law, Place, Where, Words, gain


def _places(context: Context) -> list[Place]:
    import mujoco

    model, kinds = context.case.model, (mujoco.mjtTrn.mjTRN_TENDON, mujoco.mjtTrn.mjTRN_SLIDERCRANK)
    names = context.case.actuator_names
    return [(n,) for n in names if model.actuator_trntype[model.actuator(n).id] in [int(k) for k in kinds]]


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        edit.scale_drive(name, math.exp(values["ratio"]))


EFFECT = Effect(
    name="tendon_gain",
    where=Where("actuator", _places),
    parameters=gain(0.15, 0.015),
    apply=_apply,
    words=Words(
        title="gain of the drive",
        description="The whole force of a drive that pulls a tendon or pushes a crank is scaled: motor_gain of a hand.",
        signature="All joints of the tendon sag more under load and answer more slowly, by the same ratio.",
        excitation=("load or acceleration",),
        changed_by="a motor that was exchanged, or is hot or weak",
    ),
    law=Law(form=EXACT),
)
