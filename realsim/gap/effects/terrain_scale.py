"""The terrain as a whole is larger or smaller than in the model."""

import numpy as np

from realsim.gap.effects.base import EXACT, Edit, Effect, Law, Place, Where, Words, on_the_ground, relative


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
    where=Where("global", lambda context: [()] if context.terrain else []),
    parameters=relative((-0.5, 1.0), 0.1, 0.005),
    apply=_apply,
    words=Words(
        title="terrain scale",
        description="All terrain but the ground plane is scaled about the world's origin: a wrong metric scale.",
        signature="All steps are too high or too low by the same ratio.",
        excitation=("standing on several heights",),
    ),
    excited_by=on_the_ground,
    law=Law(form=EXACT),
)
