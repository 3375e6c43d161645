"""The feet slip earlier or later than in the model."""

from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import GROUND, Edit, Effect, Law, Place, Words, on_the_ground, relative


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for geom in edit.spec.geoms:
        put(geom, "friction", 0, geom.friction[0] * (1 + values["ratio"]))


EFFECT = Effect(
    name="ground_friction",
    where=GROUND,
    parameters=relative((-0.92, 2.0), -0.4, 0.1),
    apply=_apply,
    words=Words(
        settings=("friction of feet and terrain", "physics_material of the terrain", "friction in the MJCF"),
        title="ground friction",
        description="The sliding friction coefficient of all contacts is scaled.",
        signature="Feet slide where the model's stick (or the reverse): base position and yaw drift under shear load.",
        excitation=("shear forces near the friction limit",),
        changed_by="another floor or worn feet",
    ),
    excited_by=on_the_ground,
    law=Law(abrupt=True),
)
