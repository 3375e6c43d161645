"""A body's centre of mass lies elsewhere."""

from __future__ import annotations

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [(name,) for name in context.heavy(0.015)]


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    reach = context.reach(place[0])
    return tuple(Parameter(axis, "m", (-reach, reach), 0.02, nuisance=0.0015) for axis in "xyz")


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(True, "gravity acts on it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    shift = np.array([values[a] for a in "xyz"])
    for name in place:
        body = edit.spec.body(name)
        mass, com, inertia = edit.inertia_of(body)
        edit.set_inertia(body, mass, com + shift, inertia)


EFFECT = Effect(
    name="com_offset",
    title="centre of mass",
    scope="body",
    description="The centre of mass of a body is shifted in the body's frame; mass and inertia stay.",
    signature="A torque that turns with the pose; on a floating base, weight moves from some feet to others.",
    excitation="Several poses under gravity.",
    changed_by="something that was moved",
    directed=True,
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    form=EXACT,
    variants=(("x",), ("y",), ("z",), ("x", "y", "z")),
)
