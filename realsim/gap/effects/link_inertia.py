"""A body's rotational inertia differs."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [(name,) for name in context.heavy(0.015)]


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("ratio", "ratio", (-0.85, 6.0), 0.6, nuisance=0.03, report=lambda z: 1 + z),)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(True, "angular acceleration shows it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com, inertia * (1 + values["ratio"]))


EFFECT = Effect(
    name="link_inertia",
    title="link inertia",
    scope="body",
    description="The inertia tensor of a body is scaled; mass and centre of mass stay.",
    signature="Error in proportion to angular acceleration of that link, whatever joint turns it; no effect at rest.",
    excitation="Fast angular acceleration about several axes.",
    changed_by="a part that was exchanged",
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    form=EXACT,
    usual="armature",  # a drawing tells a link's inertia, but not a rotor's
)
