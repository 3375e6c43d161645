"""A spring between motor and link."""

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import JOINTS, Edit, Effect, Excitation, Law, Parameter, Place, Words

EVERYDAY = 0.1
"""Share of the step by which any joint gives: 2 mrad at its peak torque. No gear is rigid, and friction gives before it
slips (bristles: Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995). Set on seven arms of seeds 1087 and
1123, where a little compliance was named beside a joint's friction. Not on robots whose feet touch: no time step bears
so stiff a spring, so it stays linear there, and beside it three of ten quadrupeds of seed 1301 got a cause too many."""


def _softest_step(context: Context, place: Place) -> float:
    """rad/(N m) below which the explicit spring is not stable at the model's time step."""
    return max(context.timestep**2 / (0.6 * max(context.armature(j), 0.2 * context.inertia[j])) for j in place)


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    scale = 1 / min(max(context.peak_torque[j], 1e-6) for j in place)
    least = _softest_step(context, place)
    step = max(0.02 * scale, 1.5 * least)
    bounds, usual = (0.0, max(0.6 * scale, 4 * least)), 0.0 if context.touches else EVERYDAY * step
    return (Parameter("stiffness", "N m/rad", bounds, step, nuisance=usual, report=_stiffness),)


def _stiffness(compliance: float) -> float:
    """What is fitted is the compliance, which is zero for a rigid joint."""
    return 1 / max(compliance, 1e-9)


def _excited(context: Context, place: Place) -> Excitation:
    load = context.load(place)
    return Excitation(load > 0.01, f"the gear carries {load:.0%} of the torque range")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    if values["stiffness"] <= 0:
        return
    stiffness = 1 / max(values["stiffness"], _softest_step(edit.context, place))
    for joint in place:
        tendon = edit.split_rotor(joint)
        tendon.springlength = [0.0, 0.0]
        put(tendon, "stiffness", 0, stiffness)
        put(tendon, "damping", 0, 0.04 * (stiffness * edit.context.inertia[joint]) ** 0.5)


EFFECT = Effect(
    name="joint_compliance",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="joint compliance",
        description="The gear or link gives way like a spring in series with the motor.",
        signature="Output-side position error in proportion to the load that no servo reacts to; ringing after steps.",
        excitation=("load", "output-side encoders, or an IMU beyond the joint"),
        changed_by="a loose or worn gear or belt",
        sort="thing",
    ),
    excited_by=_excited,
    law=Law(stiff=True),
)
