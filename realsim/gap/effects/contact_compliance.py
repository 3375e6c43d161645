"""The ground gives way more (or less) than the model's."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [()] if context.touches else []


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", "s", (-0.006, 0.3), 0.02, nuisance=0.0015),)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.touches, "the robot stands on it" if context.touches else "nothing touches")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for body in [edit.spec.worldbody, *(edit.spec.body(b) for b in edit.context.terrain)]:
        for geom in body.geoms:
            solref = geom.solref
            if solref[0] > 0:
                solref[0] = max(solref[0] + values["time_constant"], 2 * edit.context.timestep)
                geom.solref = solref


EFFECT = Effect(
    name="contact_compliance",
    title="contact compliance",
    scope="global",
    description="The time constant of the ground's contact (MuJoCo's solref) is larger: a mat, grass, rubber feet.",
    signature="Softer touchdown, the base sinks and sways with the load; joints are right.",
    excitation="Load changes and touchdowns.",
    changed_by="another floor or worn feet",
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    stiff=True,
)
