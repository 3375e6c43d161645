"""More (or less) dry friction in a joint."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import LOGGED, Edit, Effect, Excitation, Parameter, Place, Rivals, Suggestion, Words
from realsim.gap.effects.sizes import size_of_dry_friction
from realsim.gap.effects.stribeck_friction import higher_at_rest

ONE_WAY = 0.2
"""rad or m that a joint moves one way: then dry friction is a constant torque, and one of what that may be."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.friction(j) for j in place)
    scale = min(context.torque_scale(j) for j in place)
    top = max(context.torque_range[j] for j in place)
    step = max(0.5 * nominal, 0.04 * scale, 1e-4)
    price = 0.05 * nominal + 0.002 * scale
    size = size_of_dry_friction(context, place)
    return (Parameter("friction", "N m", (-nominal, top), step, nuisance=price, none_left=True, plausible=size),)


def _excited(context: Context, place: Place) -> Excitation:
    turns, travel = min(context.reversals[j] for j in place), min(context.travel(j) for j in place)
    return Excitation(turns >= 1 or travel > ONE_WAY, f"the velocity changes sign {turns} times")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        edit.add_friction(joint, values["friction"])


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """The same in motion, and more of it at rest; under a load that changes little, friction in proportion to it."""
    friction, load = values["friction"], context.usual_torque(place)
    grows = [Suggestion("load_friction", place, {"ratio": friction / load})] if load else []
    return [higher_at_rest(context, place, friction), *grows] if friction > 0 else []


EFFECT = Effect(
    name="coulomb_friction",
    where=LOGGED,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("frictionloss of the joint", "friction of the actuator", "frictionloss in the MJCF"),
        title="Coulomb friction",
        description="A constant torque against the motion, and sticking at rest.",
        signature="A constant error that changes sign with the velocity; flats at reversals; hysteresis at rest.",
        excitation=("slow motion with reversals, from both sides",),
        changed_by="wear, dirt or a tighter seal",
    ),
    excited_by=_excited,
    rivals=Rivals(suggest=_suggests),
)
