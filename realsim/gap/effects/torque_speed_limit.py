"""The torque that is left falls with speed (back-EMF)."""

from __future__ import annotations

import numpy as np

from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, each_joint


def _parameters(context, place: Place) -> tuple[Parameter, ...]:  # type: ignore[no-untyped-def]
    speed = max(context.speed[j] for j in place)
    return (Parameter("no_load_speed", "rad/s", (0.0, 1.6), 0.7, report=lambda z: speed / max(z, 1e-3)),)


def _excited(context, place: Place) -> Excitation:  # type: ignore[no-untyped-def]
    share = max(context.load_at_speed[j] for j in place)
    return Excitation(share > 0.08, f"torque and speed together reach {share:.0%} of range times peak speed")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """clip(u, -T - c v, T - c v) with c = T / v0 is the same as clip(u + c v, -T, T) - c v: plain MuJoCo."""
    if values["no_load_speed"] <= 0:
        return
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        limit = edit.context.torque_range[joint]
        slope = limit * values["no_load_speed"] / max(edit.context.speed[j] for j in place)
        bias = actuator.biasprm
        bias[2] += slope
        actuator.biasprm = bias
        actuator.forcerange, actuator.forcelimited = np.array([-limit, limit]), 1
        target = edit.spec.joint(edit.motor_joint(joint))
        damping = target.damping
        damping[0] += slope
        target.damping = damping
        edit.signals.torque_damping[joint] = edit.signals.torque_damping.get(joint, 0.0) + slope


EFFECT = Effect(
    name="torque_speed_limit",
    title="torque-speed limit",
    scope="joint",
    description="The highest torque falls linearly with speed to zero at the no-load speed.",
    signature="Slow motion is right under any load; fast motion is cut at its peaks, more so against load.",
    excitation="High speed and high torque at the same time.",
    places=each_joint,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
)
