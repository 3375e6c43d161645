"""More (or less) friction in proportion to speed."""

import math

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import (
    EXACT,
    LOGGED,
    Distinction,
    Edit,
    Effect,
    Excitation,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Words,
    servo_damping,
)
from realsim.gap.effects.sizes import size_of_damping


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.damping(j) for j in place)
    scale = min(context.torque_scale(j) / context.speed_scale(j) for j in place)
    step = max(0.5 * nominal, 0.08 * scale, 1e-5)
    bounds = (-nominal, 20 * max(scale, nominal))
    price = 0.05 * nominal + 0.003 * scale
    size = size_of_damping(context, place)
    return (Parameter("damping", "N m s/rad", bounds, step, nuisance=price, none_left=True, plausible=size),)


def _excited(context: Context, place: Place) -> Excitation:
    speed = max(context.speed[j] for j in place)
    return Excitation(speed > 0.02, f"peak speed {speed:.2g} rad/s")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        target = edit.spec.joint(edit.motor_joint(joint))
        put(target, "damping", 0, max(target.damping[0] + values["damping"], 0.0))


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The servo's damping gain brakes alike; only the drive's torque tells them apart."""
    if context.case.has("joint_torque") or not set(place) <= set(context.driven):
        return []
    servo = servo_damping(context, place)
    more = values["damping"] / servo if servo > 0 else -1.0
    return [Suggestion("damping_gain", place, {"ratio": math.log1p(more)})] if more > -1 else []


EFFECT = Effect(
    name="viscous_friction",
    where=LOGGED,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("damping of the joint (passive)", "viscous_friction of the actuator", "damping in the MJCF"),
        title="viscous friction",
        description="A torque against the motion in proportion to speed (grease, back-EMF through the gear).",
        signature="Lag that grows with speed; nothing at rest; the drive's torque shows it, a damping gain's does not.",
        excitation=("several speeds",),
        told_by=(Distinction("a damping gain", "measured torque", ("joint_torque",)),),
        changed_by="grease that is colder or warmer",
    ),
    excited_by=_excited,
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests),
)
