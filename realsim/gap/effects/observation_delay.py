"""Joint readings arrive late."""

from __future__ import annotations

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
from realsim.gap.simulation.context import Context


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    return (Parameter("delay", "s", (-0.01, 0.2), 0.01, nuisance=0.0012),)


def _apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
    edit.signals.observation_delay += values["delay"]


def _suggests(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
    """Where only joints are compared, late commands and late readings are one thing."""
    return [Suggestion("command_delay", place, values)] if joint_signals_only(context) else []


EFFECT = Effect(
    name="observation_delay",
    title="observation delay",
    scope="global",
    description="Joint positions, velocities and torques are logged a fixed time after they were true; the IMU is not.",
    signature="The same lag at all joints and speeds, while IMU and base pose are on time.",
    excitation="Motion; an IMU or base pose tells it from a delay of the command.",
    changed_by="other software or another bus",
    places=everywhere,
    parameters=_parameters,
    excited_by=always,
    apply=_apply,
    form=EXACT,
    patchable=False,
    suggests=_suggests,
)
