"""Inputs and outputs of the policy, one row per policy step, from the runs of a case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import read_npz
from realsim.core.geometry import cross
from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case
from realsim.gap.checks.camera.recorded import in_metres, recorded_frames
from realsim.gap.checks.contract.policy import Camera

LEAST = 20
"""Policy steps: a run with fewer says nothing."""


@dataclass(frozen=True)
class Run:
    """One run (K policy steps), joints in the log's order."""

    name: str
    time: F64
    command: F64
    """(K, J) rad sent."""
    pos: F64
    vel: F64
    gyro: F64
    """(K, 3) rad/s."""
    quat: F64
    """(K, 4) w x y z."""
    commanded: F64 | None
    """(K, 3) the velocity command; None where it is not logged."""
    sent: Bool
    """(K,) whether the command changed in this row."""
    torque: F64 | None = None
    lin_vel: F64 | None = None
    """(K, 3) m/s of the base, its own axes."""
    frames: F64 | None = None
    """(K, H, W) m: the newest depth frame at each row."""
    images: F64 | None = None
    """(K, M, H, W) what the network is shown at each row; see `loop.looking`."""

    @cached_property
    def down(self) -> F64:
        """(K, 3) down in the body's axes. A search asks for it thousands of times."""
        return turn(self.quat * [1, -1, -1, -1], np.tile([0.0, 0.0, -1.0], (len(self.quat), 1)))

    def at(self, rows: Any, seen: Any = None) -> Run:
        """Only these rows; `seen` are those of the readings, where they are others than those of the commands."""
        seen = rows if seen is None else seen
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("name", "images")}
        own = ("time", "command", "sent")
        picked: dict[str, Any] = {k: None if v is None else v[rows if k in own else seen] for k, v in values.items()}
        return replace(self, **picked)


@dataclass(frozen=True)
class Steps:
    """A log at its policy's steps."""

    joints: tuple[str, ...]
    runs: tuple[Run, ...]
    period: float
    """s between two rows."""
    changes: float
    """s between two changes of the command."""
    notes: tuple[str, ...] = ()

    def each(self, change: Callable[[Run], Run]) -> Steps:
        return replace(self, runs=tuple(map(change, self.runs)))


def read_steps(case: Case, camera: Camera | None = None) -> Steps:
    """The rows of a case's runs.

    Args:
        case: with joint positions, velocities, gyroscope and orientation. Runs may hold `policy_command` (T, 3), the
            velocity command that the policy was given.
        camera: of the policy: depth frames of its size are read along.

    Raises:
        GapError: an array that a policy needs is not logged.
    """
    for signal, what in (
        ("joint_vel", "joint velocities"), ("imu_gyro", "a gyroscope"), ("base_quat", "an orientation"),
    ):  # fmt: skip
        if not case.has(signal):
            raise GapError(
                f"a policy cannot be replayed without {what}", file=case.folder, expected=f"{signal} in each run",
                hint=f"record it; realsim log RECORDING --model {case.folder / 'model.xml'} says why something is "
                'left out (an IMU needs <site name="imu"/> in the model)',
            )  # fmt: skip
    if case.command_kind != "position":
        raise GapError("the log does not command positions", file=case.folder, found=case.command_kind)
    joints = [case.joint_names.index(_driven(case, a)) for a in case.actuator_names]
    runs, periods, changes, notes = [], [], [], []
    for run in case.runs:
        moved = np.concatenate([[True], (np.abs(np.diff(run.command, axis=0)) > 1e-9).any(axis=1)])
        if len(run.time) < LEAST:
            continue
        s = run.signals
        periods.append(float(np.median(np.diff(run.time))))
        if moved.sum() > LEAST:
            changes.append(float(np.median(np.diff(run.time[moved]))))
        quat = _units(_newest(s["base_quat"]))
        torque = s["joint_torque"][:, joints] if "joint_torque" in s and case.torque_kind != "none" else None
        lin_vel = None
        if "base_pos" in s and np.isfinite(s["base_pos"]).all():
            lin_vel = turn(quat * [1, -1, -1, -1], np.gradient(s["base_pos"], run.time, axis=0))
        frames, note = _frames(case, run.name, run.time, camera)
        notes += [note] if note else []
        runs.append(
            Run(
                run.name, run.time, run.command, _newest(s["joint_pos"][:, joints]), _newest(s["joint_vel"][:, joints]),
                _newest(s["imu_gyro"]), quat, _commanded(case, run.name, len(run.time)), moved,
                None if torque is None or not np.isfinite(torque).any() else _newest(torque), lin_vel, frames,
            )
        )  # fmt: skip
    if not runs:
        raise GapError(f"no run has {LEAST} samples", file=case.folder)
    period = float(np.median(periods))
    return Steps(
        tuple(case.joint_names[j] for j in joints), tuple(runs), period,
        float(np.median(changes)) if changes else period, tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def at_changes(steps: Steps, late: int = 0) -> Steps:
    """Only the rows in which the command changes; what was seen then is `late` rows older."""

    def thin(run: Run) -> Run:
        rows = np.flatnonzero(run.sent)
        return run.at(rows, np.clip(rows - late, 0, None))

    return replace(steps.each(thin), period=steps.changes)


def every(steps: Steps, count: int) -> Steps:
    """Every n-th row."""
    found = steps.each(lambda run: run.at(slice(None, None, count)))
    return replace(found, period=steps.period * count, changes=max(steps.changes, steps.period * count))


def liveliest(steps: Steps, rows: int, of_each: int) -> Steps:
    """At most about `rows` rows: of every run (the longest first) the stretch of `of_each` whose commands move most."""

    def stretch(run: Run) -> Run:
        length = min(of_each, len(run.time))
        moved = np.concatenate([[0.0], np.cumsum(np.sum(np.abs(np.diff(run.command, axis=0)), axis=1))])
        begin = int(np.argmax(moved[length - 1 :] - moved[: len(moved) - length + 1]))
        return run.at(slice(begin, begin + length))

    runs = sorted(steps.runs, key=lambda r: -len(r.time))[: max(1, rows // of_each)]
    return replace(steps, runs=tuple(map(stretch, runs)))


def turn(quat: F64, v: F64) -> F64:
    """(K, 3) vectors rotated by unit quaternions w x y z (K, 4)."""
    w, u = quat[:, :1], quat[:, 1:]
    t = 2 * cross(u, v)
    return np.asarray(v + w * t + cross(u, t))


def _driven(case: Case, actuator: str) -> str:
    model = case.model
    return str(model.joint(int(model.actuator_trnid[model.actuator(actuator).id, 0])).name)


def _newest(values: F64) -> F64:
    """(T, K) with a missing sample as the newest before it (the first that there is, at the start): what a loop saw."""
    good = np.isfinite(values)
    index = np.maximum.accumulate(np.where(good, np.arange(len(values))[:, None], -1), axis=0)
    return np.take_along_axis(values, np.where(index < 0, np.argmax(good, axis=0)[None], index), axis=0)


def _units(quat: F64) -> F64:
    return quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-9)


def _commanded(case: Case, name: str, count: int) -> F64 | None:
    path = case.folder / "runs" / f"{name}.npz"
    if path.is_file():
        found = read_npz(path).get("policy_command")
        if found is not None and found.shape == (count, 3) and np.isfinite(found).all():
            return np.asarray(found, dtype=np.float64)
    return None


def _frames(case: Case, name: str, time: F64, camera: Camera | None) -> tuple[F64 | None, str]:
    """(K, H, W) m and a note where there are none that fit."""
    if camera is None:
        return None, ""
    found = recorded_frames(case.folder / "runs", name)
    if found is None:
        return None, "no depth frames are logged"
    _, stamps, read = found
    newest = np.clip(np.searchsorted(stamps, time, side="right") - 1, 0, None)
    kept, back = np.unique(newest, return_inverse=True)
    images = in_metres(read(kept))
    if images.shape[1:] != camera.shape[1:]:
        size = " x ".join(map(str, images.shape[1:]))
        return None, f"depth frames are {size}, the policy sees {camera.shape[1]} x {camera.shape[2]}: not replayed"
    return images[back], ""
