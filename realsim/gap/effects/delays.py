"""Delays, of commands or of readings: one law. Where only joints are compared, they are one thing."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EXACT,
    Edit,
    Effect,
    Parameter,
    Place,
    Suggestion,
    always,
    everywhere,
    joint_signals_only,
)


def delay(name: str, title: str, twin: str, description: str, signature: str, excitation: str) -> Effect:
    """The effect that adds to the field `name` of the simulator's signals, in seconds; `twin` is the other one."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        setattr(edit.signals, name, getattr(edit.signals, name) + values["delay"])

    def suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
        return [Suggestion(twin, place, values)] if joint_signals_only(context) else []

    return Effect(
        name=name,
        title=title,
        scope="global",
        description=description,
        signature=signature,
        excitation=excitation,
        changed_by="other software or another bus",
        places=everywhere,
        parameters=lambda context, place: (Parameter("delay", "s", (-0.01, 0.2), 0.01, nuisance=0.0012),),
        excited_by=always,
        apply=apply,
        form=EXACT,
        patchable=False,
        suggests=suggests,
    )
