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
    joint_signals_only,
)
from realsim.gap.effects.sizes import size_of_delay

LONGEST = 2.0
"""s: a queue or a lost clock, not a bus."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    size = size_of_delay(context, place)
    return (Parameter("delay", "s", (-0.01, LONGEST), 0.01, nuisance=0.0012, plausible=size),)


def delay(name: str, twin: str, words: Words) -> Effect:
    """The effect that adds to the field `name` of the simulator's signals, in seconds; `twin` is the other one."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        setattr(edit.signals, name, getattr(edit.signals, name) + values["delay"])

    def suggest(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
        return [Suggestion(twin, place, values)] if joint_signals_only(context) else []

    return Effect(
        name=name,
        where=EVERYWHERE,
        parameters=_parameters,
        apply=apply,
        words=words,
        patchable=False,
        law=Law(form=EXACT),
        rivals=Rivals(suggest, compared=(twin,)),
    )
