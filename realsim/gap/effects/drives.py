"""Gains and limits of drives: of a joint, of a tendon, of a rotor that pushes."""

import math

import numpy as np

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
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Where,
    Words,
    gain,
    servo_damping,
)


def _excited_motor_gain(context: Context, place: Place) -> Excitation:
    load = context.load(place)
    return Excitation(load > 0.02, f"the drive works at {load:.0%} of its torque range")


def _apply_motor_gain(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        edit.scale_drive(edit.context.actuator[joint], ratio)


MOTOR_GAIN = Effect(
    name="motor_gain",
    where=JOINTS,
    parameters=gain(0.15, 0.015),
    apply=_apply_motor_gain,
    words=Words(
        title="motor gain",
        description="The whole force of the actuator is scaled (torque constant, supply voltage, gear efficiency).",
        signature="More sag under load and slower response at once: stiffness and damping change by the same ratio.",
        excitation=("load or acceleration",),
        changed_by="a motor that was exchanged, or is hot or weak",
    ),
    excited_by=_excited_motor_gain,
    law=Law(form=EXACT),
)


def _excited_stiffness_gain(context: Context, place: Place) -> Excitation:
    position = context.case.command_kind == "position"
    return Excitation(position, "a position servo" if position else "the servo has no position gain")


def _apply_stiffness_gain(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        put(actuator, "gainprm", 0, actuator.gainprm[0] * ratio)
        put(actuator, "biasprm", 1, actuator.biasprm[1] * ratio)


STIFFNESS_GAIN = Effect(
    name="stiffness_gain",
    where=JOINTS,
    parameters=gain(0.15, 0.015),
    apply=_apply_stiffness_gain,
    words=Words(
        settings=("stiffness of the actuator", "stiffness of the actuator", "stiffness in deploy.yaml"),
        title="stiffness gain (kp)",
        description="The servo turns position error into torque with another gain than the model's.",
        signature="Steady position error under load scales with 1/ratio; fast motion changes less than by motor gain.",
        excitation=("load at rest or slow motion",),
        changed_by="a servo that was exchanged or set otherwise",
    ),
    excited_by=_excited_stiffness_gain,
    law=Law(form=EXACT),
)


def _excited_damping_gain(context: Context, place: Place) -> Excitation:
    speed = max(context.speed[j] for j in place)
    torque = context.case.command_kind == "torque"
    return Excitation(not torque and speed > 0.02, f"peak speed {speed:.2g} rad/s")


def _apply_damping_gain(edit: Edit, place: Place, values: dict[str, float]) -> None:
    ratio = math.exp(values["ratio"])
    for joint in place:
        actuator = edit.spec.actuator(edit.context.actuator[joint])
        if edit.context.case.command_kind == "velocity":
            put(actuator, "gainprm", 0, actuator.gainprm[0] * ratio)
        put(actuator, "biasprm", 2, actuator.biasprm[2] * ratio)


def _suggests_damping_gain(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Viscous friction brakes like the servo; only the drive's torque, or its limit, tells them apart."""
    if context.case.has("joint_torque"):
        return []
    damping = math.expm1(values["ratio"]) * servo_damping(context, place)
    return [Suggestion("viscous_friction", place, {"damping": damping})]


DAMPING_GAIN = Effect(
    name="damping_gain",
    where=JOINTS,
    parameters=gain(0.25, 0.03),
    apply=_apply_damping_gain,
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
    excited_by=_excited_damping_gain,
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests_damping_gain),
)


SATURATED = 0.99
"""Share of its limit that a drive of the model must reach for a higher one to show."""
HIGHEST = 3.0
"""Times the model's limit."""


def _parameters_torque_limit(context: Context, place: Place) -> tuple[Parameter, ...]:
    peak = max(context.peak_torque[j] for j in place)
    low = 1 - HIGHEST if _saturates(context, place) else 0.0
    return (Parameter("limit", "N m", (low, 0.97), 0.35, report=lambda z: peak * (1 - z)),)


def _saturates(context: Context, place: Place) -> bool:
    return all(context.limited(j) and context.peak_torque[j] > SATURATED * context.torque_range[j] for j in place)


def _excited_torque_limit(context: Context, place: Place) -> Excitation:
    peak = max(context.peak_torque[j] for j in place)
    higher = "higher limits show, too" if _saturates(context, place) else "only lower limits would show"
    return Excitation(peak > 0, f"the nominal drive uses up to {peak:.3g} N m: {higher}")


def _apply_torque_limit(edit: Edit, place: Place, values: dict[str, float]) -> None:
    if values["limit"] == 0:
        return  # the coordinate is the cut below the highest torque that the nominal drive ever uses
    limit = max(edit.context.peak_torque[j] for j in place) * (1 - values["limit"])
    for joint in place:
        edit.limit_drive(joint, limit, beyond=values["limit"] < 0)


TORQUE_LIMIT = Effect(
    name="torque_limit",
    where=JOINTS,
    parameters=_parameters_torque_limit,
    apply=_apply_torque_limit,
    words=Words(
        settings=("effort_limit of the actuator", "effort_limit of the actuator", "the drive's torque limit"),
        title="torque limit",
        description="The force of the actuator is clipped at another value than in the model (current limit, heat).",
        signature="No error until the load or acceleration is high; then the joint falls behind, and catches up.",
        excitation=("torques above the true limit: fast steps, heavy poses",),
        changed_by="a current limit, or a motor that is hot",
        sort="thing",
    ),
    excited_by=_excited_torque_limit,
    law=Law(joint_figure=True, abrupt=True),
)


def _parameters_torque_speed_limit(context: Context, place: Place) -> tuple[Parameter, ...]:
    speed = max(context.speed[j] for j in place)
    return (Parameter("no_load_speed", "rad/s", (0.0, 4.0), 0.7, report=lambda z: speed / max(z, 1e-3)),)


def _excited_torque_speed_limit(context: Context, place: Place) -> Excitation:
    share = max(context.load_at_speed[j] for j in place)
    return Excitation(share > 0.08, f"torque and speed together reach {share:.0%} of range times peak speed")


def _apply_torque_speed_limit(edit: Edit, place: Place, values: dict[str, float]) -> None:
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


TORQUE_SPEED_LIMIT = Effect(
    name="torque_speed_limit",
    where=JOINTS,
    parameters=_parameters_torque_speed_limit,
    apply=_apply_torque_speed_limit,
    words=Words(
        title="torque-speed limit",
        description="The highest torque falls linearly with speed to zero at the no-load speed.",
        signature="Slow motion is right under any load; fast motion is cut at its peaks, more so against load.",
        excitation=("high speed and high torque at the same time",),
        sort="thing",
    ),
    excited_by=_excited_torque_speed_limit,
    law=Law(joint_figure=True),
)


def _places_tendon_gain(context: Context) -> list[Place]:
    import mujoco

    model, kinds = context.case.model, (mujoco.mjtTrn.mjTRN_TENDON, mujoco.mjtTrn.mjTRN_SLIDERCRANK)
    names = context.case.actuator_names
    return [(n,) for n in names if model.actuator_trntype[model.actuator(n).id] in [int(k) for k in kinds]]


def _apply_tendon_gain(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        edit.scale_drive(name, math.exp(values["ratio"]))


TENDON_GAIN = Effect(
    name="tendon_gain",
    where=Where("actuator", _places_tendon_gain),
    parameters=gain(0.15, 0.015),
    apply=_apply_tendon_gain,
    words=Words(
        title="gain of the drive",
        description="The whole force of a drive that pulls a tendon or pushes a crank is scaled: motor_gain of a hand.",
        signature="All joints of the tendon sag more under load and answer more slowly, by the same ratio.",
        excitation=("load or acceleration",),
        changed_by="a motor that was exchanged, or is hot or weak",
    ),
    law=Law(form=EXACT),
)


TRANSMISSION_SITE = 4
"""mjTRN_SITE"""


def thrusters(context: Context) -> list[str]:
    """Actuators that push a site or a body instead of turning a joint."""
    import mujoco

    model, pushing = context.case.model, (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_BODY)
    names = context.case.actuator_names
    return [n for n in names if model.actuator_trntype[model.actuator(n).id] in [int(t) for t in pushing]]


def _places_thrust_gain(context: Context) -> list[Place]:
    """All together (a battery, thin air), and each (a propeller)."""
    names = thrusters(context)
    return [(), *((name,) for name in names)] if names else []


def _apply_thrust_gain(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place or thrusters(edit.context):
        edit.scale_drive(name, math.exp(values["ratio"]))


def _suggests_thrust_gain(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """A weight beside a rotor that gives less: in a hover both ask more of it, and differ in how the robot turns about
    the rotor's axis alone."""
    if len(place) != 1 or values["ratio"] >= 0:
        return []
    model, i = context.case.model, context.case.model.actuator(place[0]).id
    if model.actuator_trntype[i] != TRANSMISSION_SITE:
        return []
    site = model.site(int(model.actuator_trnid[i, 0]))
    body = model.body(int(site.bodyid[0])).name
    mass = context.total_mass / len(thrusters(context)) * -math.expm1(values["ratio"])
    return [Suggestion("payload", (body,), {"mass": mass, **dict(zip("xyz", map(float, site.pos), strict=True))})]


THRUST_GAIN = Effect(
    name="thrust_gain",
    where=Where("actuator", _places_thrust_gain),
    parameters=gain(0.1, 0.015),
    apply=_apply_thrust_gain,
    words=Words(
        title="thrust",
        description="A thruster (an actuator on a site or a body), or all, push by a ratio: propeller, battery, air.",
        signature="Less lift like a mass that is not there, but the turning is slower, too; of one rotor, a lean.",
        excitation=("climbing and turning",),
        told_by=(Distinction("a payload", "quick turns, or a weighing"),),
        changed_by="another battery or propeller, another altitude",
    ),
    law=Law(form=EXACT),
    rivals=Rivals(_suggests_thrust_gain, compared=("payload",)),
)
