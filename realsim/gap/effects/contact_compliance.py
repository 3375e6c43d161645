"""The ground gives way more (or less) than the model's."""

from realsim.gap.case.model.edit import put
from realsim.gap.effects.base import GROUND, Edit, Effect, Law, Parameter, Place, Words, fixed, on_the_ground


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    for body in [edit.spec.worldbody, *(edit.spec.body(b) for b in edit.context.terrain)]:
        for geom in body.geoms:
            if geom.solref[0] > 0:
                put(geom, "solref", 0, max(geom.solref[0] + values["time_constant"], 2 * edit.context.timestep))


EFFECT = Effect(
    name="contact_compliance",
    where=GROUND,
    parameters=fixed(Parameter("time_constant", "s", (-0.006, 0.3), 0.02, nuisance=0.0015)),
    apply=_apply,
    words=Words(
        title="contact compliance",
        description="The time constant of the ground's contact (MuJoCo's solref) is larger: a mat, grass, rubber feet.",
        signature="Softer touchdown, the base sinks and sways with the load; joints are right.",
        excitation=("load changes and touchdowns",),
        changed_by="another floor or worn feet",
    ),
    excited_by=on_the_ground,
    law=Law(stiff=True),
)
