"""What else is between a motor and its link: a rotor's inertia, a spring, a torque that goes with the position."""

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import EXACT, JOINTS, Distinction, Edit, Effect, Excitation, Law, Parameter, Place, Words
from realsim.gap.effects.sizes import size_of_rotor


def _parameters_armature(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.armature(j) for j in place)
    inertia = min(context.inertia[j] for j in place)
    step = max(0.4 * nominal, 0.1 * inertia, 1e-6)
    bounds, price = (-nominal, 20 * max(nominal, inertia)), 0.03 * nominal + 1e-7
    return (
        Parameter(
            "armature", "kg m^2", bounds, step, nuisance=price, none_left=True, plausible=size_of_rotor(context, place)
        ),
    )


def _excited_armature(context: Context, place: Place) -> Excitation:
    share = max(context.inertial_share[j] for j in place)
    return Excitation(share > 0.005, f"acceleration takes {share:.1%} of the torque")


def _apply_armature(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        target = edit.spec.joint(edit.motor_joint(joint))
        target.armature = max(target.armature + values["armature"], 1e-7)


ARMATURE = Effect(
    name="armature",
    where=JOINTS,
    parameters=_parameters_armature,
    apply=_apply_armature,
    words=Words(
        settings=("armature of the actuator", "armature of the actuator", "armature in the MJCF"),
        title="rotor inertia (armature)",
        description="The inertia of the rotor seen through the gear is not the model's.",
        signature="Error in proportion to acceleration, the same in every pose; overshoot after steps.",
        excitation=("fast changes of velocity",),
        changed_by="a motor or gear that was exchanged",
    ),
    excited_by=_excited_armature,
    law=Law(form=EXACT),
)


EVERYDAY = 0.1
"""Share of the step by which any joint gives: 2 mrad at its peak torque. No gear is rigid, and friction gives before it
slips (bristles: Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995). Set on seven arms of seeds 1087 and
1123, where a little compliance was named beside a joint's friction. Not on robots whose feet touch: no time step bears
so stiff a spring, so it stays linear there, and beside it three of ten quadrupeds of seed 1301 got a cause too many."""


def _softest_step(context: Context, place: Place) -> float:
    """rad/(N m) below which the explicit spring is not stable at the model's time step."""
    return max(context.timestep**2 / (0.6 * max(context.armature(j), 0.2 * context.inertia[j])) for j in place)


def _parameters_joint_compliance(context: Context, place: Place) -> tuple[Parameter, ...]:
    scale = 1 / min(max(context.peak_torque[j], 1e-6) for j in place)
    least = _softest_step(context, place)
    step = max(0.02 * scale, 1.5 * least)
    bounds, usual = (0.0, max(0.6 * scale, 4 * least)), 0.0 if context.touches else EVERYDAY * step
    return (Parameter("stiffness", "N m/rad", bounds, step, nuisance=usual, report=lambda z: 1 / max(z, 1e-9)),)


def _excited_joint_compliance(context: Context, place: Place) -> Excitation:
    load = context.load(place)
    return Excitation(load > 0.01, f"the gear carries {load:.0%} of the torque range")


def _apply_joint_compliance(edit: Edit, place: Place, values: dict[str, float]) -> None:
    if values["stiffness"] <= 0:
        return
    stiffness = 1 / max(values["stiffness"], _softest_step(edit.context, place))
    for joint in place:
        tendon = edit.split_rotor(joint)
        tendon.springlength = [0.0, 0.0]
        put(tendon, "stiffness", 0, stiffness)
        put(tendon, "damping", 0, 0.04 * (stiffness * edit.context.inertia[joint]) ** 0.5)


JOINT_COMPLIANCE = Effect(
    name="joint_compliance",
    where=JOINTS,
    parameters=_parameters_joint_compliance,
    apply=_apply_joint_compliance,
    words=Words(
        title="joint compliance",
        description="The gear or link gives way like a spring in series with the motor.",
        signature="Output-side position error in proportion to the load that no servo reacts to; ringing after steps.",
        excitation=("load", "output-side encoders, or an IMU beyond the joint"),
        changed_by="a loose or worn gear or belt",
        sort="thing",
    ),
    excited_by=_excited_joint_compliance,
    law=Law(stiff=True),
)


HARMONICS = 2
"""Periods of one turn and of half a turn: what cables, springs and magnets with two poles do."""
TRAVEL = 0.3
"""rad of motion over which the torque's course shows."""


def _parameters_position_torque(context: Context, place: Place) -> tuple[Parameter, ...]:
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.1 * scale, 1e-4)
    names = ["constant", *(f"{wave}_{n}" for n in range(1, HARMONICS + 1) for wave in ("cos", "sin"))]
    return tuple(Parameter(name, "N m", (-top, top), step) for name in names)


def _excited_position_torque(context: Context, place: Place) -> Excitation:
    travel = min(context.travel(j) for j in place)
    return Excitation(travel > TRAVEL, f"the joint moves over {travel:.2g} rad")


def _apply_position_torque(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Constant plus cosines and sines of multiples of the joint's angle, in the loop that steps the model."""
    series = list(values.values())
    if not any(series):
        return
    for joint in place:
        before = edit.signals.position_torque.get(joint, [0.0] * len(series))
        edit.signals.position_torque[joint] = [a + b for a, b in zip(before, series, strict=True)]


POSITION_TORQUE = Effect(
    name="position_torque",
    where=JOINTS,
    parameters=_parameters_position_torque,
    apply=_apply_position_torque,
    words=Words(
        title="position-dependent torque",
        description="A torque that depends on the joint's angle alone: a constant, waves of one turn and half a turn.",
        signature="The same error at the same angle, whatever the speed and its sign; a servo holds some angles lower.",
        excitation=("slow motion over the joint's range, both ways",),
        told_by=(Distinction("gravity", "other loads"),),
    ),
    excited_by=_excited_position_torque,
    variants=(("constant",), ("constant", "cos_1", "sin_1"), ()),
    patchable=False,
)
