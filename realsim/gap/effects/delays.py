"""Delays, of commands or of readings, which are one thing where only joints are compared; and lags of actuators."""

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
    Where,
    Words,
    joint_signals_only,
)
from realsim.gap.effects.sizes import size_of_delay

LONGEST, LONGEST_LAG = 2.0, 0.5
"""s: a queue or a lost clock, not a bus; a large propeller."""
EVERYDAY = 0.2
"""Of a lag that the model has: with voltage and speed a motor's changes by as much. Not tuned."""


def _parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    size = size_of_delay(context, place)
    return (Parameter("delay", "s", (-0.01, LONGEST), 0.01, nuisance=0.0012, plausible=size),)


def delay(name: str, twin: str, where: Where, words: Words, commoner: str | None = None) -> Effect:
    """The effect that adds to the field `name` of the simulator's signals, in seconds; `twin` is the other one."""

    def apply(edit: Edit, place: Place, values: dict[str, float]) -> None:
        setattr(edit.signals, name, getattr(edit.signals, name) + values["delay"])

    def suggest(context: Context, place: Place, values: dict[str, float]) -> list[Suggestion]:
        found = [Suggestion(twin, place, values)] if joint_signals_only(context) else []
        return [*found, Suggestion("actuator_lag", place, {"lag": max(values["delay"], 0.0)})]

    return Effect(
        name=name,
        where=where,
        parameters=_parameters,
        apply=apply,
        words=words,
        patchable=False,
        law=Law(form=EXACT),
        rivals=Rivals(suggest, commoner=commoner, compared=(twin,)),
    )


COMMAND_DELAY = delay(
    "command_delay",
    "observation_delay",
    EVERYWHERE,
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
OBSERVATION_DELAY = delay(
    "observation_delay",
    "command_delay",
    Where("global", lambda context: [()] if context.case.joint_names else []),
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
    commoner="command_delay",  # readings are stamped when they are taken; commands wait for buses and drives
)


def _lag_parameters(context: Context, place: Place) -> tuple[Parameter, ...]:
    """Beside the actuators' own lags in the model, of which no more than all can be taken away."""
    size, own = size_of_delay(context, place), float(min(context.case.lags.values(), default=0.0))
    return (Parameter("lag", "s", (-own, LONGEST_LAG), 0.01, nuisance=EVERYDAY * own, plausible=size),)


def _apply_lag(edit: Edit, place: Place, values: dict[str, float]) -> None:
    edit.signals.actuator_lag += values["lag"]


ACTUATOR_LAG = Effect(
    name="actuator_lag",
    where=Where("global", lambda context: [()] if len(context.case.lags) == len(context.case.actuator_names) else []),
    parameters=_lag_parameters,
    apply=_apply_lag,
    words=Words(
        settings=("dyntype and dynprm of the actuators", "the actuator's model", "the motors' own response"),
        title="lag of the actuators",
        description="What actuators give follows what is commanded with a first-order lag: rotors that spin up, a slow "
        "loop of current, a filter of set-points. Of a motor its force lags, of a position servo its set-point.",
        signature="Slow commands come late by the time constant, fast ones are weaker, too.",
        excitation=("commands that change slowly and quickly",),
        told_by=(Distinction("a delay of the command", "commands that jump"),),
        changed_by="other motors, propellers or filters",
    ),
    law=Law(form=EXACT),
    rivals=Rivals(
        lambda context, place, values: [Suggestion("command_delay", place, {"delay": values["lag"]})],
        commoner="command_delay",  # a real double pendulum's late commands look as much like a lag
    ),
)
