"""A piece of terrain is higher or lower than in the model."""

from __future__ import annotations

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [(name,) for name in context.terrain]


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("height", "m", (-0.1, 0.1), 0.01, nuisance=0.0012),)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.touches, "the robot stands on it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        body.pos = np.asarray(body.pos) + np.array([0.0, 0.0, values["height"]])


EFFECT = Effect(
    name="terrain_height",
    title="terrain height",
    scope="terrain",
    description="A piece of terrain stands higher or lower by a constant.",
    signature="From the first moment the leg on it is more or less loaded, and the base leans.",
    excitation="Standing on it, with base pose, IMU or joint positions under load.",
    directed=True,
    comparatives=("lower", "higher"),
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    abrupt=True,
    form=EXACT,
)
