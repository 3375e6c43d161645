"""The drive saturates earlier than the model says, or, where the model's saturates, later."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import JOINTS, Edit, Effect, Excitation, Law, Parameter, Place, Words

SATURATED = 0.99
"""Share of its limit that a drive of the model must reach for a higher one to show."""
HIGHEST = 3.0
"""Times the model's limit."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    peak = max(context.peak_torque[j] for j in place)
    low = 1 - HIGHEST if _saturates(context, place) else 0.0
    return (Parameter("limit", "N m", (low, 0.97), 0.35, report=lambda z: peak * (1 - z)),)


def _saturates(context: Context, place: Place) -> bool:
    return all(context.limited(j) and context.peak_torque[j] > SATURATED * context.torque_range[j] for j in place)


def _excited(context: Context, place: Place) -> Excitation:
    peak = max(context.peak_torque[j] for j in place)
    higher = "higher limits show, too" if _saturates(context, place) else "only lower limits would show"
    return Excitation(peak > 0, f"the nominal drive uses up to {peak:.3g} N m: {higher}")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    if values["limit"] == 0:
        return  # the coordinate is the cut below the highest torque that the nominal drive ever uses
    limit = max(edit.context.peak_torque[j] for j in place) * (1 - values["limit"])
    for joint in place:
        edit.limit_drive(joint, limit, beyond=values["limit"] < 0)


EFFECT = Effect(
    name="torque_limit",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("effort_limit of the actuator", "effort_limit of the actuator", "the drive's torque limit"),
        title="torque limit",
        description="The force of the actuator is clipped at another value than in the model (current limit, heat).",
        signature="No error until the load or acceleration is high; then the joint falls behind, and catches up.",
        excitation=("torques above the true limit: fast steps, heavy poses",),
        changed_by="a current limit, or a motor that is hot",
        sort="thing",
    ),
    excited_by=_excited,
    law=Law(joint_figure=True, abrupt=True),
)
