"""The terrain as a whole is larger or smaller than in the model."""

from __future__ import annotations

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import EXACT, Edit, Effect, Excitation, Parameter, Place


def _places(context: Context) -> list[Place]:
    return [()] if context.terrain else []


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("ratio", "ratio", (-0.5, 1.0), 0.1, nuisance=0.005, report=lambda z: 1 + z),)


def _excited(context: Context, place: Place) -> Excitation:
    return Excitation(context.touches, "the robot stands on it")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    import mujoco

    ratio = 1 + values["ratio"]
    for name in edit.context.terrain:
        body = edit.spec.body(name)
        body.pos = np.asarray(body.pos) * ratio
        for geom in body.geoms:
            geom.pos = np.asarray(geom.pos) * ratio
            if geom.type != mujoco.mjtGeom.mjGEOM_PLANE:
                geom.size = np.asarray(geom.size) * ratio
            fromto = np.asarray(geom.fromto)
            if np.isfinite(fromto).all():
                geom.fromto = fromto * ratio


EFFECT = Effect(
    name="terrain_scale",
    title="terrain scale",
    scope="global",
    description="All terrain but the ground plane is scaled about the world's origin: a wrong metric scale.",
    signature="All steps are too high or too low by the same ratio.",
    excitation="Standing on several heights.",
    places=_places,
    parameters=_parameters,
    excited_by=_excited,
    apply=_apply,
    form=EXACT,
)
