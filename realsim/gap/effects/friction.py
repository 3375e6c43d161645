"""Friction of a joint by its laws: dry, viscous, higher at rest, in proportion to the load; and of all joints."""

import math

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import (
    EXACT,
    JOINTS,
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
    Where,
    Words,
    fixed,
    servo_damping,
)
from realsim.gap.effects.sizes import size_of_damping, size_of_dry_friction

ONE_WAY = 0.2
"""rad or m that a joint moves one way: then dry friction is a constant torque, and one of what that may be."""


def _parameters_coulomb_friction(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.friction(j) for j in place)
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.5 * nominal, 0.04 * scale, 1e-4)
    price = 0.05 * nominal + 0.002 * scale
    size = size_of_dry_friction(context, place)
    return (Parameter("friction", "N m", (-nominal, top), step, nuisance=price, none_left=True, plausible=size),)


def _excited_coulomb_friction(context: Context, place: Place) -> Excitation:
    turns, travel = min(context.reversals[j] for j in place), min(context.travel(j) for j in place)
    return Excitation(turns >= 1 or travel > ONE_WAY, f"the velocity changes sign {turns} times")


def _apply_coulomb_friction(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        edit.add_friction(joint, values["friction"])


def _suggests_coulomb_friction(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The same in motion, and more of it at rest; under a load that changes little, friction in proportion to it."""
    friction, load = values["friction"], context.usual_torque(place)
    grows = [Suggestion("load_friction", place, {"ratio": friction / load})] if load else []
    return [higher_at_rest(context, place, friction), *grows] if friction > 0 else []


COULOMB_FRICTION = Effect(
    name="coulomb_friction",
    where=LOGGED,
    parameters=_parameters_coulomb_friction,
    apply=_apply_coulomb_friction,
    words=Words(
        settings=("frictionloss of the joint", "friction of the actuator", "frictionloss in the MJCF"),
        title="Coulomb friction",
        description="A constant torque against the motion, and sticking at rest.",
        signature="A constant error that changes sign with the velocity; flats at reversals; hysteresis at rest.",
        excitation=("slow motion with reversals, from both sides",),
        changed_by="wear, dirt or a tighter seal",
    ),
    excited_by=_excited_coulomb_friction,
    rivals=Rivals(suggest=_suggests_coulomb_friction),
)


def _parameters_viscous_friction(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.damping(j) for j in place)
    scale = min(context.torque_scale(j) / context.speed_scale(j) for j in place)
    step = max(0.5 * nominal, 0.08 * scale, 1e-5)
    bounds = (-nominal, 20 * max(scale, nominal))
    price = 0.05 * nominal + 0.003 * scale
    size = size_of_damping(context, place)
    return (Parameter("damping", "N m s/rad", bounds, step, nuisance=price, none_left=True, plausible=size),)


def _excited_viscous_friction(context: Context, place: Place) -> Excitation:
    speed = max(context.speed[j] for j in place)
    return Excitation(speed > 0.02, f"peak speed {speed:.2g} rad/s")


def _apply_viscous_friction(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        target = edit.spec.joint(edit.motor_joint(joint))
        put(target, "damping", 0, max(target.damping[0] + values["damping"], 0.0))


def _suggests_viscous_friction(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The servo's damping gain brakes alike; only the drive's torque tells them apart."""
    if context.case.has("joint_torque") or not set(place) <= set(context.driven):
        return []
    servo = servo_damping(context, place)
    more = values["damping"] / servo if servo > 0 else -1.0
    return [Suggestion("damping_gain", place, {"ratio": math.log1p(more)})] if more > -1 else []


VISCOUS_FRICTION = Effect(
    name="viscous_friction",
    where=LOGGED,
    parameters=_parameters_viscous_friction,
    apply=_apply_viscous_friction,
    words=Words(
        settings=("damping of the joint (passive)", "viscous_friction of the actuator", "damping in the MJCF"),
        title="viscous friction",
        description="A torque against the motion in proportion to speed (grease, back-EMF through the gear).",
        signature="Lag that grows with speed; nothing at rest; the drive's torque shows it, a damping gain's does not.",
        excitation=("several speeds",),
        told_by=(Distinction("a damping gain", "measured torque", ("joint_torque",)),),
        changed_by="grease that is colder or warmer",
    ),
    excited_by=_excited_viscous_friction,
    law=Law(form=EXACT),
    rivals=Rivals(suggest=_suggests_viscous_friction),
)


WIDEST = 0.4
"""rad/s, well above what gears show: a friction that falls over a wider range of speeds imitates other things."""

HIGHER_AT_REST = 1.05
"""Ratio of friction at rest to friction in motion from which on it is no Coulomb friction."""

DRY = ("coulomb_friction", "friction")
"""To first order it is dry friction, whose slopes cost an eighth; the search goes on from there."""

FINEST = 4
"""A falling friction drives a light joint unstable at a coarse time step, which is divided by up to this."""


def _parameters_stribeck_friction(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.friction(j) for j in place)
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.6 * nominal, 0.05 * scale, 1e-4)
    speed = max(context.speed[j] for j in place)
    widest = min(0.4 * speed, WIDEST)
    return (
        Parameter("static_friction", "N m", (0.0, top), step, like=DRY, plausible=size_of_dry_friction(context, place)),
        Parameter("coulomb", "N m", (0.0, top), 0.5 * step, like=DRY),
        Parameter("stribeck_velocity", "rad/s", (0.02 * widest, widest), 0.12 * widest, default=0.3 * widest),
    )


def _excited_stribeck_friction(context: Context, place: Place) -> Excitation:
    turns = min(context.reversals[j] for j in place)
    return Excitation(turns >= 2, f"the velocity changes sign {turns} times")


def _apply_stribeck_friction(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Dry friction raised by F at rest, of which C stays in motion: the piecewise-linear Stribeck curve.

    That is friction F minus clip(c v, -(F - C), F - C) with c = (F - C) / v_s.
    """
    static, moving = values["static_friction"], values["coulomb"]
    if static <= HIGHER_AT_REST * moving:
        return  # that is Coulomb friction, which has a name of its own; here it would only be its rival
    falling = static - moving
    for joint in place:
        name = edit.motor_joint(joint)
        edit.add_friction(joint, static)
        wanted = falling / values["stribeck_velocity"]
        stable = 0.4 * edit.context.inertia[joint] / edit.context.timestep
        finer = int(np.clip(np.ceil(wanted / stable), 1, FINEST))
        edit.spec.option.timestep = min(edit.spec.option.timestep, edit.context.timestep / finer)
        slope = min(wanted, finer * stable)
        helper = edit.add_helper(f"stribeck_{joint}", name, slope)
        helper.forcerange, helper.forcelimited = np.array([-falling, falling]), 1


BEGUN = 1.5
"""Ratio of friction at rest to friction in motion to search from: near the law that this one contains. From two and a
half and from three times it, fits stuck at up to 280 nats more (1511/122, 1613/102; not in 1409/161, 1301/128)."""


def higher_at_rest(context: Context, place: Place, moving: float) -> Suggestion:
    """Above the friction in motion: below it, friction at rest does nothing, and no slope leads out of there."""
    usual = next(p.default for p in _parameters_stribeck_friction(context, place) if p.name == "stribeck_velocity")
    values = {"static_friction": BEGUN * moving, "coulomb": moving, "stribeck_velocity": usual}
    return Suggestion("stribeck_friction", place, values)


def _suggests_stribeck_friction(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Begun anew near Coulomb friction; and Coulomb friction, which is this without a fall."""
    moving = values.get("coulomb", 0.0) or values["static_friction"]
    return [Suggestion("coulomb_friction", place, {"friction": moving}), higher_at_rest(context, place, moving)]


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    where=LOGGED,
    parameters=_parameters_stribeck_friction,
    apply=_apply_stribeck_friction,
    words=Words(
        title="Stribeck friction",
        description="Dry friction is higher near rest and falls to its level in motion over the Stribeck velocity.",
        signature="Stick and jerk at slow reversals; fast motion is right.",
        excitation=("very slow motion with reversals beside fast motion",),
        changed_by="wear or lack of grease",
    ),
    excited_by=_excited_stribeck_friction,
    law=Law(stiff=True),
    rivals=Rivals(suggest=_suggests_stribeck_friction, special_case="coulomb_friction"),
)


def _excited_load_friction(context: Context, place: Place) -> Excitation:
    load, turns = context.load(place), min(context.reversals[j] for j in place)
    return Excitation(load > 0.02 and turns >= 1, f"load {load:.0%} of the range, {turns} reversals")


def _apply_load_friction(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """MuJoCo's dry friction is constant: the loop that steps the model changes it (realsim.gap.simulation.stepping)."""
    for joint in place:
        edit.signals.load_friction[joint] = edit.signals.load_friction.get(joint, 0.0) + values["ratio"]
        added = max(values["ratio"], 0.0) * edit.context.torque_scale(joint)
        if added:
            edit.stiffen_friction(joint, added / (edit.context.friction(joint) + added))


def _suggests_load_friction(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """On a joint that holds or lifts, friction of r times the torque acts as a drive that is weaker by 1 + r; where the
    load changes little, as friction that does not depend on it."""
    weaker = {"ratio": -math.log1p(values["ratio"])}
    constant = {"friction": values["ratio"] * context.usual_torque(place)}
    found = [Suggestion("stiffness_gain", place, weaker), Suggestion("motor_gain", place, weaker)]
    return [*found, Suggestion("coulomb_friction", place, constant)]


LOAD_FRICTION = Effect(
    name="load_friction",
    where=JOINTS,
    parameters=fixed(Parameter("ratio", "ratio", (-0.05, 0.8), 0.1, nuisance=0.01)),
    apply=_apply_load_friction,
    words=Words(
        title="load-dependent friction",
        description="Gear friction that grows with the torque that the gear carries: a ratio of its size.",
        signature="Like Coulomb friction, but larger where the load is; lifting and lowering differ, an unloaded joint "
        "is right.",
        excitation=("the same motion under different loads",),
        changed_by="wear of the gear",
        ratio_of="the drive's torque",
    ),
    excited_by=_excited_load_friction,
    patchable=False,
    law=Law(stepwise=True),
    rivals=Rivals(suggest=_suggests_load_friction, compared=("stiffness_gain", "motor_gain")),
)


MOST = 12
"""Joints; with more, this many values at once can explain anything."""
VISCOUS = " viscous"


def _places_friction_of_joints(context: Context) -> list[Place]:
    return [tuple(context.driven)] if 2 <= len(context.driven) <= MOST else []


def _parameters_friction_of_joints(context: Context, place: Place) -> tuple[Parameter, ...]:
    """One value a joint, named after it, of either kind; none of them is an everyday deviation of its own."""
    dry = [_one(COULOMB_FRICTION, context, j, j) for j in place]
    return (*dry, *(_one(VISCOUS_FRICTION, context, j, j + VISCOUS) for j in place))


def _one(effect: Effect, context: Context, joint: str, name: str) -> Parameter:
    (p,) = effect.parameters(context, (joint,))
    return Parameter(name, p.unit, p.bounds, p.step, none_left=p.none_left)


def _excited_friction_of_joints(context: Context, place: Place) -> Excitation:
    still = [j for j in place if context.reversals[j] < 1]
    return Excitation(not still, f"no reversal of {', '.join(still)}" if still else "every joint turns back")


def _apply_friction_of_joints(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        COULOMB_FRICTION.apply(edit, (joint,), {"friction": values[joint]})
        VISCOUS_FRICTION.apply(edit, (joint,), {"damping": values[joint + VISCOUS]})


FRICTION_OF_JOINTS = Effect(
    name="friction_of_joints",
    where=Where("joint", _places_friction_of_joints),
    parameters=_parameters_friction_of_joints,
    apply=_apply_friction_of_joints,
    words=Words(
        title="friction of every joint",
        description="Dry and viscous friction of all joints, each with values of its own: a model without its gears.",
        signature="Every joint lags and sticks, each by its own amount; no single joint explains it.",
        excitation=("slow and fast motion with reversals of every joint",),
    ),
    excited_by=_excited_friction_of_joints,
)
