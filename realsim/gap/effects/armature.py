"""The rotor's reflected inertia differs."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, JOINTS, Edit, Effect, Excitation, Law, Parameter, Place, Words
from realsim.gap.effects.sizes import size_of_rotor


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    nominal = min(context.armature(j) for j in place)
    inertia = min(context.inertia[j] for j in place)
    step = max(0.4 * nominal, 0.1 * inertia, 1e-6)
    bounds, price = (-nominal, 20 * max(nominal, inertia)), 0.03 * nominal + 1e-7
    return (
        Parameter(
            "armature", "kg m^2", bounds, step, nuisance=price, none_left=True, plausible=size_of_rotor(context, place)
        ),
    )


def _excited(context: Context, place: Place) -> Excitation:
    share = max(context.inertial_share[j] for j in place)
    return Excitation(share > 0.005, f"acceleration takes {share:.1%} of the torque")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for joint in place:
        target = edit.spec.joint(edit.motor_joint(joint))
        target.armature = max(target.armature + values["armature"], 1e-7)


EFFECT = Effect(
    name="armature",
    where=JOINTS,
    parameters=_parameters,
    apply=_apply,
    words=Words(
        settings=("armature of the actuator", "armature of the actuator", "armature in the MJCF"),
        title="rotor inertia (armature)",
        description="The inertia of the rotor seen through the gear is not the model's.",
        signature="Error in proportion to acceleration, the same in every pose; overshoot after steps.",
        excitation=("fast changes of velocity",),
        changed_by="a motor or gear that was exchanged",
    ),
    excited_by=_excited,
    law=Law(form=EXACT),
)
