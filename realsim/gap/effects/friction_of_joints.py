"""Friction of the whole robot: every joint has its own, and all of them are one cause."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects import coulomb_friction, viscous_friction
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place, Where, Words

MOST = 12
"""Joints; with more, this many values at once can explain anything."""
VISCOUS = " viscous"


def _places(context: Context) -> list[Place]:
    return [tuple(context.driven)] if 2 <= len(context.driven) <= MOST else []


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    """One value a joint, named after it, of either kind; none of them is an everyday deviation of its own."""
    dry = [_one(coulomb_friction.EFFECT, context, j, j) for j in place]
    return (*dry, *(_one(viscous_friction.EFFECT, context, j, j + VISCOUS) for j in place))


def _one(effect: Effect, context: Context, joint: str, name: str) -> Parameter:
    (p,) = effect.parameters(context, (joint,))
    return Parameter(name, p.unit, p.bounds, p.step, none_left=p.none_left)


def _excited(context: Context, place: Place) -> Excitation:
    still = [j for j in place if context.reversals[j] < 1]
    return Excitation(not still, f"no reversal of {', '.join(still)}" if still else "every joint turns back")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        coulomb_friction.EFFECT.apply(edit, (joint,), {"friction": values[joint]})
        viscous_friction.EFFECT.apply(edit, (joint,), {"damping": values[joint + VISCOUS]})


EFFECT = Effect(
    name="friction_of_joints",
    where=Where("joint", _places),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="friction of every joint",
        description="Dry and viscous friction of all joints, each with values of its own: a model without its gears.",
        signature="Every joint lags and sticks, each by its own amount; no single joint explains it.",
        excitation=("slow and fast motion with reversals of every joint",),
    ),
    excited_by=_excited,
)
