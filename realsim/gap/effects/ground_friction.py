"""The feet slip earlier or later than in the model."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [()] if context.touches else []


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("ratio", "ratio", (-0.92, 2.0), -0.4, nuisance=0.1, report=lambda z: 1 + z),)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.touches, "the robot stands on it" if context.touches else "nothing touches")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for geom in edit.spec.geoms:
        friction = geom.friction
        friction[0] *= 1 + values["ratio"]
        geom.friction = friction


EFFECT = Effect(
    name="ground_friction",
    title="ground friction",
    scope="global",
    description="The sliding friction coefficient of all contacts is scaled.",
    signature="Feet slide where the model's stick (or the reverse): drift of base position and yaw under shear load.",
    excitation="Shear forces near the friction limit.",
    changed_by="another floor or worn feet",
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    abrupt=True,
)
