"""One run of a log: read from .npz or .csv; harmless faults are repaired with a note, others refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, refuse_unknown
from realsim.core.files import check_size, digest, read_npz
from realsim.core.types import F64, Bool, MjModel
from realsim.gap.case.csv_runs import read_csv
from realsim.gap.case.setups import Setup, read_setups
from realsim.gap.case.units import in_si

SIGNAL_SHAPES: dict[str, str | int] = {
    "joint_pos": "J",
    "joint_vel": "J",
    "joint_torque": "J",
    "base_pos": 3,
    "base_quat": 4,
    "imu_gyro": 3,
    "imu_acc": 3,
    "contact": "F",
}
FRAMES = ("depth", "depth_time")
"""Arrays of the depth camera, with a clock of their own: read by `realsim.gap.checks.camera` where they are wanted."""
REQUIRED = ("time", "command", "joint_pos")
"""Of a body without joints, its pose instead of joint positions."""
OFF_AFTER = 0.1
"""Seconds without any command from which on a drive is off; shorter gaps are lost messages, and a command holds."""
MAX_SAMPLES = 5_000_000
LEAST_SAMPLES = 20
GAP, SHORTEST_GAP, LONGEST_STEP = 4.0, 0.05, 0.2
"""Usual steps, and s, that a step of the clock must exceed to be a gap: a late loop holds its command about as long.
No servo's log has steps above the last one, s. Not tuned."""
LARGEST = 1e6
"""No joint, motor or accelerometer reads as much in SI units: such values are damage (benchmarks/robustness/fuzz.py:
1e300)."""


@dataclass(frozen=True)
class Run:
    """One trajectory on the robot. Arrays as in the contract; missing samples are NaN."""

    name: str
    time: F64
    """(T,) seconds, strictly increasing, the first is 0."""
    command: F64
    """(T, U), held between samples."""
    signals: dict[str, F64]
    """joint_pos (T, J) and whatever else was logged."""
    init_qpos: F64 | None = None
    init_qvel: F64 | None = None
    setup: Setup = field(default_factory=Setup)
    """Known differences of this run from model.xml."""
    enabled: Bool | None = None
    """(T, U) bool, whether the drive gives torque from this sample to the next; None if all do throughout."""
    goes_on: bool = False
    """Whether it is what follows a gap in a recording: its robot may be moving at the first sample."""

    def __repr__(self) -> str:
        return f"Run({self.name!r}, {len(self.time)} samples of {', '.join(self.signals)})"

    def where(self, keep: Bool | slice) -> Run:
        """The same run, only of the samples that a mask or a slice of (T,) keeps."""
        return replace(
            self,
            time=self.time[keep],
            command=self.command[keep],
            signals={name: values[keep] for name, values in self.signals.items()},
            enabled=None if self.enabled is None else self.enabled[keep],
        )

    def part(self, rows: Bool | slice) -> Run:
        """These rows, of a slice or a mask, with a clock from 0; a given first state is that of the first row only."""
        part = self.where(rows)
        begun = float(part.time[0])
        part = replace(part, time=part.time - begun)
        return replace(part, init_qpos=None, init_qvel=None) if begun else part

    def stretches(self, shortest: float) -> list[Run]:
        """The stretches between gaps in time that last so many s or more, each a run; itself where it has no gap.

        Nobody knows what was commanded in a gap, so nothing may be predicted across one.
        """
        ends = [0, *find_gaps(self.time), len(self.time)]
        parts = [replace(self.part(slice(a, b)), name=f"{self.name}_{k}", goes_on=a > 0)
                 for k, (a, b) in enumerate(pairwise(ends), 1) if b - a >= LEAST_SAMPLES]  # fmt: skip
        return [p for p in parts if p.duration >= shortest] if len(ends) > 2 else [self]

    @property
    def samples(self) -> str:
        """Digest of the samples: two runs with the same one are one recording."""
        names = sorted(self.signals)
        return digest(names, self.time, self.command, *(self.signals[k] for k in names))

    @property
    def on(self) -> Bool:
        """(T, U) bool: `enabled`, or all True."""
        return np.ones(self.command.shape, bool) if self.enabled is None else self.enabled

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])


def usual_step(time: F64) -> float:
    """s of the step in which a log is at most moments: neither stamps that come in bursts nor single gaps move it."""
    steps = np.sort(np.diff(time))
    passed = np.cumsum(np.minimum(steps, LONGEST_STEP))
    return float(steps[np.searchsorted(passed, passed[-1] / 2)]) if len(steps) else 0.0


def find_gaps(time: F64) -> list[int]:
    """The first rows after gaps of an increasing clock (T,), s."""
    return [int(k) + 1 for k in np.flatnonzero(np.diff(time) > max(GAP * usual_step(time), SHORTEST_GAP))]


@dataclass(frozen=True)
class Layout:
    """Expected arrays of a run, from log.json and model.xml."""

    names: Mapping[str, Sequence[str]]
    """Array -> the names of its columns (joints, actuators, axes)."""
    nq: int
    nv: int
    command_kind: str
    columns: Mapping[str, Any] | None
    """Where the arrays stand in .csv files, or None."""
    setups: Mapping[str, Setup]
    """Run -> what is known to differ from model.xml in it."""
    units: Mapping[str, str]
    """Array -> the unit that .npz files have it in, where that is not the contract's."""


def layout(
    joints: Sequence[str],
    actuators: Sequence[str],
    contact: Sequence[str],
    model: MjModel,
    log: Mapping[str, Any],
    file: Path,
) -> Layout:
    """The arrays' columns by name, from what log.json (`file`) says. Raises GapError for units of no array."""
    wide = {"J": tuple(joints), "F": tuple(contact), 3: tuple("xyz"), 4: tuple("wxyz")}
    names = {"time": ("time",), "command": tuple(actuators), "enabled": tuple(actuators)}
    names |= {k: wide[v] for k, v in SIGNAL_SHAPES.items()}
    units = log.get("units") or {}
    if not isinstance(units, Mapping) or not all(isinstance(u, str) for u in units.values()):
        raise GapError(
            "units of log.json cannot be read",
            file=file,
            expected='{"time": "ms", "joint_pos": "deg"}',
            found=repr(units)[:80],
        )
    for array in units:
        refuse_unknown(array, names, f"units of log.json name {array!r}, which is no array of a log", file)
    setups = read_setups(log.get("runs"), model, file)
    return Layout(names, model.nq, model.nv, str(log["command_kind"]), log.get("columns"), setups, units)


def read_run(path: Path, want: Layout, warnings: list[str]) -> Run:
    """One .npz or .csv file. Raises GapError for what cannot be used; adds to `warnings` what was mended."""
    check_size(path)
    if path.suffix == ".csv":
        data = read_csv(path, want.columns, want.names, want.command_kind, warnings)
    else:
        data = _read_npz(path)
        for name, unit in want.units.items():
            if name in data:
                data[name] = in_si(data[name], name, unit, want.command_kind, path)
    jointless = not want.names["joint_pos"]
    for name in ("time", "command", "base_pos", "base_quat") if jointless else REQUIRED:
        if name not in data:
            raise GapError(f"array {name!r} is missing", file=path, found=", ".join(sorted(data)) or "nothing")
    if jointless:
        data = {k: v for k, v in data.items() if not k.startswith("joint_")}
    return _checked(path, data, want, warnings)


def _read_npz(path: Path) -> dict[str, F64]:
    arrays = {}
    for name, values in read_npz(path).items():
        if name in FRAMES:
            continue
        if values.dtype.kind not in "fiub":  # text, too: what was written as text may have been cut
            raise GapError(
                "not a readable .npz of plain numbers",
                file=path,
                expected="arrays of numbers",
                found=f"{name} of type {values.dtype}",
            )
        arrays[name] = np.asarray(values, dtype=np.float64)
    return arrays


def _checked(path: Path, data: dict[str, F64], want: Layout, warnings: list[str]) -> Run:
    time = data["time"].reshape(-1)
    count = len(time)
    if count < LEAST_SAMPLES:
        raise GapError(
            "the run is too short", file=path, expected=f"at least {LEAST_SAMPLES} samples", found=str(count)
        )
    if count > MAX_SAMPLES:
        raise GapError("the run is too long", file=path, expected=f"at most {MAX_SAMPLES} samples", found=str(count))
    _check_shape(path, "command", data["command"], (count, len(want.names["command"])))
    _check_size(path, "command", data["command"])
    signals = {}
    for name in SIGNAL_SHAPES:
        if name in data and not want.names[name]:
            warnings.append(f"{path.name}: {name} is left out: contact_bodies in log.json is empty")
        elif name in data:
            _check_shape(path, name, data[name], (count, len(want.names[name])))
            _check_size(path, name, data[name])
            signals[name] = np.where(np.isfinite(data[name]), data[name], np.nan)
    signals.setdefault("joint_pos", np.zeros((count, 0)))
    empty = ~np.isfinite(signals["joint_pos"]).any(axis=0)
    if empty.any():
        joint = want.names["joint_pos"][int(np.argmax(empty))]
        raise GapError("a joint has no finite position", file=path, found=f"joint_pos of {joint} is all NaN")
    signals["joint_pos"] = _unwrapped(signals["joint_pos"], path, want.names["joint_pos"], warnings)
    keep = _trusted(time, path, warnings)
    if keep.sum() < LEAST_SAMPLES:
        raise GapError("too few samples have a time stamp", file=path, found=f"{int(keep.sum())} of {count}")
    command, enabled = _commanded(time, data, path, warnings)
    if np.ptp(time[keep]) > 3600:
        raise GapError(
            "the run lasts more than an hour",
            file=path,
            found=f"{np.ptp(time[keep]):.3g} s",
            hint='is time in seconds? If not, write "units": {"time": "ms"} in log.json, or a unit in columns.json',
        )
    qpos, qvel = data.get("init_qpos"), data.get("init_qvel")
    for name, value, size in (("init_qpos", qpos, want.nq), ("init_qvel", qvel, want.nv)):
        if value is not None and (value.shape != (size,) or not np.isfinite(value).all()):
            raise GapError(
                f"{name} does not fit the model", file=path, expected=f"({size},) finite", found=str(value.shape)
            )
    clock = time[keep] - time[keep][0]
    on = None if enabled is None else enabled[keep]
    setup = want.setups.get(path.stem, Setup())
    return Run(path.stem, clock, command[keep], {k: v[keep] for k, v in signals.items()}, qpos, qvel, setup, on)


def _unwrapped(positions: F64, path: Path, joints: Sequence[str], warnings: list[str]) -> F64:
    """Joint positions without jumps by a whole turn from one sample to the next, where readings were wrapped."""
    result = positions.copy()
    for j, joint in enumerate(joints):
        finite = np.flatnonzero(np.isfinite(positions[:, j]))
        turns = np.diff(positions[finite, j]) / (2 * np.pi)
        jumps = np.where(np.abs(np.abs(turns) - 1) < 0.1, np.round(turns), 0.0)
        if jumps.any():
            result[finite[1:], j] -= 2 * np.pi * np.cumsum(jumps)
            warnings.append(f"{path.name}: {joint} jumps by a turn {int(np.abs(jumps).sum())} times: it is unwrapped")
    return result


def _trusted(time: F64, path: Path, warnings: list[str]) -> Bool:
    """(T,) which samples have a stamp that fits in; refuses a clock that cannot be trusted at all."""
    keep = np.isfinite(time)
    if not keep.all():
        warnings.append(f"{path.name}: {int((~keep).sum())} samples without a time stamp are left out")
    latest = np.maximum.accumulate(np.where(keep, time, -np.inf))
    # Where one is no newer than any before it, the order is in doubt.
    back = keep & (time < np.concatenate([[-np.inf], latest[:-1]]))
    if back.sum() > 0.05 * len(time):
        raise GapError(
            "the clock runs backwards",
            file=path,
            expected="increasing time",
            found=f"{int(back.sum())} of {len(time)} steps go back, the first at sample {int(np.argmax(back))}",
            hint="sort the log by the robot's own clock",
        )
    if back.any():
        warnings.append(f"{path.name}: the clock runs backwards at {int(back.sum())} samples, which are left out")
    keep &= ~back
    rows = np.flatnonzero(keep)
    again = rows[:-1][np.diff(time[rows]) == 0]
    if len(again):
        warnings.append(f"{path.name}: {len(again)} time stamps repeat: the newest sample of each is used")
    keep[again] = False
    return keep


def _check_shape(path: Path, name: str, array: F64, want: tuple[int, int]) -> None:
    if array.shape != want:
        raise GapError(f"{name} has the wrong shape", file=path, expected=str(want), found=str(array.shape))


def _check_size(path: Path, name: str, array: F64) -> None:
    largest = float(np.abs(array[np.isfinite(array)]).max(initial=0.0))
    if largest > LARGEST:
        raise GapError(
            f"{name} holds values that no robot has", file=path, expected=f"up to {LARGEST:g}", found=f"{largest:g}"
        )


def _commanded(time: F64, data: Mapping[str, F64], path: Path, warnings: list[str]) -> tuple[F64, Any]:
    """(commands without holes, (T, U) bool of drives that give torque, or None if all do throughout).

    `enabled` says which drives are on. Without it, a drive is off where it has no command for longer than OFF_AFTER.
    """
    command, given = data["command"], data.get("enabled")
    bad = ~np.isfinite(command)
    if given is not None:
        _check_shape(path, "enabled", given, command.shape)
        if np.isfinite(given).any() and not np.isin(given[np.isfinite(given)], (0, 1)).all():
            raise GapError("enabled holds other values than 0 and 1", file=path, found=f"{np.nanmax(given):g}")
        on = _held(given, np.ones(given.shape[1])) > 0.5
    else:
        on = np.column_stack([~_long(column, time) for column in bad.T])
        if bad.all(axis=0).any() or (bad & on).mean() > 0.5:
            raise GapError(
                "the command is missing",
                file=path,
                found=f"{bad.mean():.0%} of the samples are not finite",
                hint="where the drives give no torque, add an array enabled (T, U) of 0 and 1",
            )
    if (lost := bad & on).any():
        warnings.append(f"{path.name}: {int(lost.any(axis=1).sum())} samples without a command hold the one before")
    if not on.all() and given is None:
        warnings.append(f"{path.name}: no command for longer than {OFF_AFTER:g} s: the drive is taken to be off there")
    return _held(command, np.zeros(command.shape[1])), None if on.all() else on


def _long(bad: Bool, time: F64) -> Bool:
    """(T,) which samples belong to holes that last longer than OFF_AFTER."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    found = np.zeros(len(bad), bool)
    for begin, end in edges.reshape(-1, 2):
        found[begin:end] = time[min(end, len(time) - 1)] - time[begin] > OFF_AFTER
    return found


def _held(values: F64, otherwise: F64) -> F64:
    """Missing values are those before them, or the first there is, or `otherwise` (K,) in an empty column."""
    filled = values.copy()
    for column in range(values.shape[1]):
        good = np.flatnonzero(np.isfinite(values[:, column]))
        if not len(good):
            filled[:, column] = otherwise[column]
            continue
        source = good[np.clip(np.searchsorted(good, np.arange(len(values)), side="right") - 1, 0, None)]
        filled[:, column] = values[source, column]
    return filled
