"""A link is longer or shorter than in the model."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import SPECK
from realsim.gap.effects.base import EXACT, Edit, Effect, Law, Parameter, Place, Where, Words, always


def _places(context: Context) -> list[Place]:
    return [(name,) for name in context.bodies if context.direction(name) is not None]


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    reach = context.reach(place[0])
    return (Parameter("length", "m", (-0.4 * reach, 0.6 * reach), 0.1 * reach, nuisance=0.001),)


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """Everything at the far end (next bodies, feet) moves along the link; the link's own mass stays."""
    for name in place:
        direction = edit.context.direction(name)
        if direction is None:
            continue
        shift = values["length"] * direction
        body = edit.spec.body(name)
        children = [child for child in body.bodies if not child.name.endswith(SPECK)]
        for child in children:
            child.pos = np.asarray(child.pos) + shift
        if not children:
            for geom in body.geoms:
                if not np.isfinite(np.asarray(geom.fromto)).all():
                    geom.pos = np.asarray(geom.pos) + shift


EFFECT = Effect(
    name="link_geometry",
    where=Where("body", _places),
    parameters=_parameters,
    apply=_apply,
    words=Words(
        title="link geometry",
        description="A link's length differs along the direction to its far end.",
        signature="Feet and tool are elsewhere than the joint angles say; gravity torque of what it carries changes.",
        excitation=("feet on the ground with base pose, or a loaded link",),
        sort="direction",
    ),
    excited_by=always("gravity on what the link carries, or its feet on the ground"),
    law=Law(form=EXACT),
)
