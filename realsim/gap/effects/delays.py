"""Delays, of commands or of readings: one law. Where only joints are compared, they are one thing."""

from __future__ import annotations

from realsim.gap.case.model.context import Context
from realsim.gap.effects.base import (
    EVERYWHERE,
    EXACT,
    Distinction,
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


COMMAND = delay(
    "command_delay",
    "observation_delay",
    Words(
        settings=(
            "delay_min_lag, delay_max_lag of the actuator",
            "DelayedPDActuatorCfg: min_delay, max_delay",
            "the loop's period and the age of lowcmd",
        ),
        description="Every command acts a fixed time after it was logged (bus, queue, low-level control rate).",
        signature="The same lag at all joints and speeds; error in proportion to the speed of the command; IMU and "
        "base lag with the joints.",
        excitation=("commands that change",),
        told_by=(
            Distinction("a delay of the joint readings", "an IMU or base pose", ("imu_gyro", "imu_acc", "base_pos")),
        ),
        changed_by="other software or another bus",
    ),
)
OBSERVATION = delay(
    "observation_delay",
    "command_delay",
    Words(
        settings=(
            "delay_min_lag, delay_max_lag of the observations",
            "delayed observations (modifiers)",
            "the age of lowstate when it is read",
        ),
        description="Joint positions, velocities and torques are logged a fixed time after they were true; the IMU is "
        "not.",
        signature="The same lag at all joints and speeds, while IMU and base pose are on time.",
        excitation=("motion",),
        told_by=(Distinction("a delay of the command", "an IMU or base pose", ("imu_gyro", "imu_acc", "base_pos")),),
        changed_by="other software or another bus",
    ),
)
