"""The torque that is left falls with speed (back-EMF)."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import JOINTS, Edit, Effect, Excitation, Law, Parameter, Place, Words


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    speed = max(context.speed[j] for j in place)
    return (Parameter("no_load_speed", "rad/s", (0.0, 4.0), 0.7, report=lambda z: speed / max(z, 1e-3)),)


def _excited(context: Context, place: Place) -> Excitation:
    share = max(context.load_at_speed[j] for j in place)
    return Excitation(share > 0.08, f"torque and speed together reach {share:.0%} of range times peak speed")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """The drive gives clip(u, max(-T, -T - c v), min(T, T - c v)) with c = T / v0, in plain MuJoCo.

    For |u| <= T that is clip(u + c v, -T, T) - c v: a helper adds c v to the servo, the joint's limit on its actuators
    clips the sum, and damping takes c v off again. (In the servo itself, a velocity gain above zero would be taken for
    a damping ratio by MuJoCo's compiler.)
    """
    if values["no_load_speed"] <= 0:
        return
    for joint in place:
        limit = edit.context.torque_range[joint]
        slope = limit * values["no_load_speed"] / max(edit.context.speed[j] for j in place)
        model, name, ends = edit.context.case.model, edit.motor_joint(joint), np.array([-limit, limit])
        i = model.joint(joint).id
        if model.jnt_actfrclimited[i]:
            ends = np.clip(ends, *model.jnt_actfrcrange[i])
        if model.jnt_actfrclimited[i] or not model.actuator(edit.context.actuator[joint]).forcelimited[0]:
            edit.limit_drive(joint, limit)
        edit.add_helper(f"back_emf_{joint}", name, slope)
        target = edit.spec.joint(name)
        target.actfrcrange, target.actfrclimited = ends, 1
        put(target, "damping", 0, target.damping[0] + slope)
        edit.signals.back_emf[joint] = slope


EFFECT = Effect(
    name="torque_speed_limit",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="torque-speed limit",
        description="The highest torque falls linearly with speed to zero at the no-load speed.",
        signature="Slow motion is right under any load; fast motion is cut at its peaks, more so against load.",
        excitation=("high speed and high torque at the same time",),
        sort="thing",
    ),
    excited_by=_excited,
    law=Law(joint_figure=True),
)
