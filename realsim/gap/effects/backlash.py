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

HARD = (0.99, 0.99, 1e-3, 0.5, 2.0)
"""MuJoCo's impedance of an end that a load keeps the link at. Its own one gives way by 7 to 8 mrad under the 11 to 13
N m of a calf in stance (seeds 3400/027, 3601/026), as much as the play; where links go to and fro, it is kept, since
fits do not come to the right gap between hard ends that they hit (3700/017). On 30 fresh draws of play and zeros
on legs (seed 4000) right alone 23 -> 24, sure and wrong 2 -> 1; on the 62 of seed 3900 nothing changes."""


def _excited(context: Context, place: Place) -> Excitation:
    turns = min(context.load_reversals[j] for j in place)
    text = f"the torque through the gear changes sign {turns} times"
    return Excitation(True, text if turns else "the torque through the gear keeps the link at one end of the gap")


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    """A rotor of its own, tied to the link only at the ends of the play."""
    if values["gap"] <= 0:
        return
    for joint in place:
        tendon = edit.split_rotor(joint)
        half = 0.5 * values["gap"]
        tendon.limited, tendon.range = 1, np.array([-half, half])
        tendon.solref_limit = np.array([STIFFEST * edit.context.timestep, 1.0])
        if not edit.context.load_reversals.get(joint, 1):
            tendon.solimp_limit = np.array(HARD)


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
