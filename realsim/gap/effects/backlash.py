"""Play between motor and link."""

import numpy as np

from realsim.gap.case.model.context import Context
from realsim.gap.case.model.edit import STIFFEST
from realsim.gap.effects.base import (
    JOINTS,
    Edit,
    Effect,
    Excitation,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Words,
    fixed,
)


def _excited(context: Context, place: Place) -> Excitation:
    turns = min(context.load_reversals[j] for j in place)
    return Excitation(turns >= 1, f"the torque through the gear changes sign {turns} times")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A rotor of its own, tied to the link only at the ends of the play."""
    if values["gap"] <= 0:
        return
    for joint in place:
        tendon = edit.split_rotor(joint)
        half = 0.5 * values["gap"]
        tendon.limited, tendon.range = 1, np.array([-half, half])
        tendon.solref_limit = np.array([STIFFEST * edit.context.timestep, 1.0])


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Under a load that does not change sign, a link that is off by half the gap, to one side."""
    return [Suggestion("joint_offset", place, {"reading_offset": side * values["gap"]}) for side in (0.5, -0.5)]


BACKLASH = Effect(
    name="backlash",
    where=JOINTS,
    parameters=fixed(Parameter("gap", "rad", (0.0, 0.3), 0.02)),
    apply=_apply,
    words=Words(
        title="backlash",
        description="The link is free to move within a gap before the motor takes it along. The gap is its full width.",
        signature="The link jumps by the gap when the load changes sign; motor and link encoders differ by up to it.",
        excitation=("load that changes sign", "output-side encoders"),
        changed_by="wear of the gear",
    ),
    excited_by=_excited,
    law=Law(stiff=True),
    rivals=Rivals(suggest=_suggests),
)
