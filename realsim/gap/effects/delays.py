"""Delays, of commands or of readings: one law. Where only joints are compared, they are one thing."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EVERYWHERE,
    EXACT,
    Edit,
    Effect,
    Law,
    Parameter,
    Place,
    Rivals,
    Suggestion,
    Words,
    fixed,
    joint_signals_only,
)

LONGEST = 2.0
"""s: a queue or a lost clock, not a bus."""


def delay(name: str, twin: str, words: Words) -> Effect:
    """The effect that adds to the field `name` of the simulator's signals, in seconds; `twin` is the other one."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        setattr(edit.signals, name, getattr(edit.signals, name) + values["delay"])

    def suggest(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
        return [Suggestion(twin, place, values)] if joint_signals_only(context) else []

    return Effect(
        name=name,
        where=EVERYWHERE,
        parameters=fixed(Parameter("delay", "s", (-0.01, LONGEST), 0.01, nuisance=0.0012)),
        apply=apply,
        words=words,
        patchable=False,
        law=Law(form=EXACT),
        rivals=Rivals(suggest, compared=(twin,)),
    )
