"""What is to be recorded: commands, and how the robot is set up for them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case
from realsim.gap.case.model.context import Context
from realsim.gap.case.runs import Run
from realsim.gap.case.setups import Setup

LEAST_RATE = 20.0
"""Samples a second: at fewer, a command cannot carry motion at 2 Hz, which is slow for a servo."""
WIDER = 0.1
"""Share of the logged range of commands by which an excitation may go beyond it on either side, within the joint's own
range: the operator has shown that the robot may go about there."""
MARGIN = 0.03
"""rad or m that a command keeps from the joint's own stops."""
RISE = 0.5
"""Seconds in which motion begins and ends: the robot starts and stops at rest."""


@dataclass(frozen=True)
class Planned:
    """One run to be recorded."""

    name: str
    time: F64
    """(T,) seconds from 0."""
    command: F64
    """(T, U) in the log's unit, held between samples."""
    enabled: Bool | None = None
    """(T, U) bool, whether the drive gives torque; None if all do throughout."""
    setup: Setup = field(default_factory=Setup)
    """A mass that is added, gains that are set."""
    shift: tuple[float, float] = (0.0, 0.0)
    """m in x and y by which the base begins elsewhere than in the first run of the log (floating bases)."""


@dataclass(frozen=True)
class Experiment:
    """One excitation of the library at one size, for one robot."""

    name: str
    title: str
    size: float
    """0..1, of the commands' range."""
    runs: tuple[Planned, ...]
    instructions: tuple[str, ...] = ()
    """What the operator must do beside sending the commands."""

    @property
    def seconds(self) -> float:
        return float(sum(run.time[-1] for run in self.runs))


@dataclass(frozen=True)
class Rig:
    """What excitations need to know about a robot: where its commands may go, how fast they are sent."""

    context: Context
    home: F64
    """(U,) command at rest: the median of the runs' first ones."""
    low: F64
    high: F64
    """(U,) ends of the commands."""
    rate: float
    """Samples a second."""
    seconds: float
    """Of one run."""
    seed: int = 0

    @property
    def case(self) -> Case:
        return self.context.case

    @property
    def time(self) -> F64:
        """(T,) of one run."""
        return np.arange(round(self.seconds * self.rate)) / self.rate

    def planned(self, name: str, shape: F64, size: float, setup: Setup | None = None, **more: Any) -> Planned:
        """A run from a shape (T, U) in -1..1: +1 is the upper end, -1 the lower, 0 home. It begins and ends at home."""
        t = self.time
        ramp = np.clip(np.minimum(t, t[-1] - t) / RISE, 0.0, 1.0)[:, None]
        part = size * ramp * shape
        command = self.home + np.where(part > 0, part * (self.high - self.home), part * (self.home - self.low))
        return Planned(name, t, command, setup=setup or Setup(), **more)


def rig_of(context: Context, seconds: float, seed: int = 0) -> Rig:
    """Read off the log: the range of its commands (a little more, within the joints' own), its rate.

    Raises:
        GapError: where the log is too slow for a command file.
    """
    case = context.case
    rate = float(np.median([(len(run.time) - 1) / run.duration for run in case.runs]))
    if rate < LEAST_RATE:
        raise GapError(
            "the log is too slow to plan an experiment from",
            file=case.folder,
            expected=f"at least {LEAST_RATE:g} samples a second",
            found=f"{rate:.3g}",
            hint="record commands and positions at 100 Hz or more",
        )
    commands = np.concatenate([run.command for run in case.runs])
    low, high = commands.min(axis=0), commands.max(axis=0)
    home = np.median([run.command[0] for run in case.runs], axis=0)
    wider = WIDER * (high - low)
    low, high = low - wider, high + wider
    if case.command_kind == "position":
        for joint, name in context.actuator.items():
            u, gear, info = case.actuator_names.index(name), case.gear(joint), case.model.joint(joint)
            if case.model.jnt_limited[info.id]:
                ends = np.sort(gear * (info.range + np.array([MARGIN, -MARGIN])))
                low[u], high[u] = max(low[u], ends[0]), min(high[u], ends[1])
    return Rig(context, home, np.minimum(low, home), np.maximum(high, home), rate, seconds, seed)


def planned_case(rig: Rig, runs: Sequence[Planned]) -> Case:
    """The case with these runs in place of the logged ones; what is not known yet is the pose at rest throughout."""
    case, first = rig.case, rig.case.runs[0]
    made = []
    for run in runs:
        count = len(run.time)
        signals = {}
        for name, values in first.signals.items():
            if case.has(name) or name == "joint_pos":  # a body without joints has none of them
                rest = np.nan_to_num(values[np.isfinite(values).all(axis=1)][0])
                signals[name] = np.tile(rest, (count, 1))
        for j, joint in enumerate(case.joint_names):
            actuator = case.actuator_of(joint)
            if case.command_kind == "position" and actuator is not None:
                command = run.command[0, case.actuator_names.index(actuator)]
                signals["joint_pos"][:, j] = command / case.gear(joint)
        for name in ("joint_vel", "joint_torque"):
            if name in signals:
                signals[name][:] = 0.0
        qpos = None if first.init_qpos is None else first.init_qpos.copy()
        if case.floating:
            at = np.array([*run.shift, 0.0])
            if "base_pos" in signals:
                signals["base_pos"] = signals["base_pos"] + at
            if qpos is not None:
                free = int(np.flatnonzero(case.model.jnt_type == 0)[0])
                start = int(case.model.jnt_qposadr[free])
                qpos[start : start + 3] += at
        made.append(Run(run.name, run.time, run.command, signals, qpos, None, run.setup, run.enabled))
    return replace(case, runs=tuple(made))
