"""The encoder's zero is wrong."""

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EXACT,
    JOINTS,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Words,
    always,
    fixed,
)


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """`offset`: servo and log read it alike. `reading_offset`: only the logged encoder has it."""
    for joint in place:
        loop, read = edit.signals.joint_offset, edit.signals.reading_offset
        loop[joint] = loop.get(joint, 0.0) + values["offset"]
        read[joint] = read.get(joint, 0.0) + values["reading_offset"]


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Play in the gear that the load keeps on one side: the link is off by half of it, which only its encoder reads, or
    which, where feet bear the load, the other joints and the base show more."""
    off = abs(values.get("offset", 0.0) + values.get("reading_offset", 0.0))
    return [Suggestion("backlash", place, {"gap": 2 * off})] if off else []


JOINT_OFFSET = Effect(
    name="joint_offset",
    where=JOINTS,
    parameters=fixed(
        Parameter("offset", "rad", (-0.4, 0.4), 0.03, nuisance=0.002),
        Parameter(
            "reading_offset",
            "rad",
            (-0.4, 0.4),
            0.03,
            nuisance=0.002,
            label="offset",
            note="only the logged encoder has it, not the servo's",
        ),
    ),
    apply=_apply,
    words=Words(
        settings=("the encoder's zero", "the encoder's zero", "the motor's zero"),
        title="encoder zero offset",
        description="The reading is the true angle plus a constant: of the encoder that the servo uses too, or only of "
        "the one that is logged (`reading_offset`).",
        signature="A constant error of a joint, or gravity loads and foot positions that belong to another angle.",
        excitation=("gravity on the joint, or feet on the ground",),
        changed_by="an encoder that was mounted anew or slipped",
        sort="direction",
    ),
    excited_by=always("gravity, contact or the servo's own reading shows it"),
    variants=(("offset",), ("reading_offset",)),
    patchable=False,
    law=Law(form=EXACT, footing=("offset",)),
    rivals=Rivals(suggest=_suggests, compared=("backlash",)),
)
