"""The drive saturates earlier than the model says."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import JOINTS, Edit, Effect, Excitation, Law, Parameter, Place, Words


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    peak = max(context.peak_torque[j] for j in place)
    return (Parameter("limit", "N m", (0.0, 0.97), 0.35, report=lambda z: peak * (1 - z)),)


def _excited(context: Context, place: Place) -> Excitation:
    peak = max(context.peak_torque[j] for j in place)
    return Excitation(peak > 0, f"the nominal drive uses up to {peak:.3g} N m: only lower limits would show")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    if values["limit"] <= 0:
        return  # the coordinate is the cut below the highest torque that the nominal drive ever uses
    limit = max(edit.context.peak_torque[j] for j in place) * (1 - values["limit"])
    for joint in place:
        edit.limit_drive(joint, limit)


EFFECT = Effect(
    name="torque_limit",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("effort_limit of the actuator", "effort_limit of the actuator", "the drive's torque limit"),
        title="torque limit",
        description="The force of the actuator is clipped at a lower value than in the model (current limit, heat).",
        signature="No error until the load or acceleration is high; then the joint falls behind, and catches up.",
        excitation=("torques above the true limit: fast steps, heavy poses",),
        changed_by="a current limit, or a motor that is hot",
        sort="thing",
    ),
    excited_by=_excited,
    law=Law(joint_figure=True, abrupt=True),
)
