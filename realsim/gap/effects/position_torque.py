"""A torque that goes with the position: a cable, a spring, cogging, gravity that the model does not know."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import JOINTS, Distinction, Edit, Effect, Excitation, Parameter, Place, Words

HARMONICS = 2
"""Periods of one turn and of half a turn: what cables, springs and magnets with two poles do."""
TRAVEL = 0.3
"""rad of motion over which the torque's course shows."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.1 * scale, 1e-4)
    names = ["constant", *(f"{wave}_{n}" for n in range(1, HARMONICS + 1) for wave in ("cos", "sin"))]
    return tuple(Parameter(name, "N m", (-top, top), step) for name in names)


def _excited(context: Context, place: Place) -> Excitation:
    travel = min(context.travel(j) for j in place)
    return Excitation(travel > TRAVEL, f"the joint moves over {travel:.2g} rad")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Constant plus cosines and sines of multiples of the joint's angle, in the loop that steps the model."""
    series = list(values.values())
    if not any(series):
        return
    for joint in place:
        before = edit.signals.position_torque.get(joint, [0.0] * len(series))
        edit.signals.position_torque[joint] = [a + b for a, b in zip(before, series, strict=True)]


EFFECT = Effect(
    name="position_torque",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="position-dependent torque",
        description="A torque that depends on the joint's angle alone: a constant, waves of one turn and half a turn.",
        signature="The same error at the same angle, whatever the speed and its sign; a servo holds some angles lower.",
        excitation=("slow motion over the joint's range, both ways",),
        told_by=(Distinction("gravity", "other loads"),),
    ),
    excited_by=_excited,
    variants=(("constant",), ("constant", "cos_1", "sin_1"), ()),
    patchable=False,
)
