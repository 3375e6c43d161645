"""A piece of terrain is higher or lower than in the model."""

import numpy as np

from realsim.gap.effects.base import EXACT, SUPPORTS, Edit, Effect, Law, Parameter, Place, Words, fixed, on_the_ground


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for name in place:
        body = edit.spec.body(name)
        body.pos = np.asarray(body.pos) + np.array([0.0, 0.0, values["height"]])


EFFECT = Effect(
    name="terrain_height",
    where=SUPPORTS,
    parameters=fixed(Parameter("height", "m", (-0.1, 0.1), 0.01, nuisance=0.0012)),
    apply=_apply,
    words=Words(
        title="terrain height",
        description="A piece of terrain stands higher or lower by a constant.",
        signature="From the first moment the leg on it is more or less loaded, and the base leans.",
        excitation=("standing on it, with base pose, IMU or joint positions under load",),
        sort="direction",
        comparatives=("lower", "higher"),
    ),
    excited_by=on_the_ground,
    law=Law(form=EXACT, abrupt=True),
)
