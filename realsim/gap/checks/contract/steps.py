"""Inputs and outputs of the policy, one row per policy step, from the runs of a case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.core.errors import GapError
from realsim.core.files import read_npz
from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case


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
    told: F64
    """(K, 3) the velocity command."""
    sent: Bool
    """(K,) whether the command changed in this row."""
    torque: F64 | None = None


@dataclass(frozen=True)
class Steps:
    """A log at its policy's steps."""

    joints: tuple[str, ...]
    runs: tuple[Run, ...]
    period: float
    """s between two rows."""
    changes: float
    """s between two changes of the command."""


def read_steps(case: Case, told: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Steps:
    """The runs of a case as policy steps: the rows of the log where it runs at the policy's rate, else those in which
    the command changes.

    Args:
        case: with joint positions, velocities, gyroscope and orientation.
        told: the velocity command, where a run has no array `policy_command` (T, 3).

    Raises:
        GapError: an array that a policy needs is not logged.
    """
    for signal, what in (
        ("joint_vel", "joint velocities"), ("imu_gyro", "a gyroscope"), ("base_quat", "an orientation"),
    ):  # fmt: skip
        if not case.has(signal):
            raise GapError(
                f"a policy cannot be replayed without {what}", file=case.folder, expected=f"{signal} in each run"
            )
    if case.command_kind != "position":
        raise GapError("the log does not command positions", file=case.folder, found=case.command_kind)
    joints = [case.joint_names.index(_driven(case, a)) for a in case.actuator_names]
    runs, periods, changes = [], [], []
    for run in case.runs:
        moved = np.concatenate([[True], (np.abs(np.diff(run.command, axis=0)) > 1e-9).any(axis=1)])
        steps = np.diff(run.time[moved])
        if len(steps) < 20:
            continue
        s = run.signals
        periods.append(float(np.median(np.diff(run.time))))
        changes.append(float(np.median(steps)))
        runs.append(
            Run(
                run.name, run.time, run.command, _newest(s["joint_pos"][:, joints]), _newest(s["joint_vel"][:, joints]),
                _newest(s["imu_gyro"]), _units(_newest(s["base_quat"])),
                _told(case.folder / "runs" / f"{run.name}.npz", len(run.time), told), moved,
                _newest(s["joint_torque"][:, joints]) if "joint_torque" in s and case.torque_kind != "none" else None,
            )
        )  # fmt: skip
    if not runs:
        raise GapError("no run has twenty policy steps", file=case.folder)
    return Steps(tuple(case.joint_names[j] for j in joints), tuple(runs), float(np.median(periods)),
                 float(np.median(changes)))  # fmt: skip


def at_changes(steps: Steps, late: int = 0) -> Steps:
    """Only the rows in which the command changes; what was seen then is `late` rows older."""

    def thin(run: Run) -> Run:
        rows = np.flatnonzero(run.sent)
        seen = np.clip(rows - late, 0, None)
        return Run(
            run.name, run.time[rows], run.command[rows], run.pos[seen], run.vel[seen], run.gyro[seen], run.quat[seen],
            run.told[seen], np.ones(len(rows), bool), None if run.torque is None else run.torque[rows],
        )  # fmt: skip

    return Steps(steps.joints, tuple(map(thin, steps.runs)), steps.changes, steps.changes)


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


def _told(path: Path, count: int, otherwise: tuple[float, float, float]) -> F64:
    if path.is_file():
        found = read_npz(path).get("policy_command")
        if found is not None and found.shape == (count, 3):
            return np.asarray(found, dtype=np.float64)
    return np.tile(np.asarray(otherwise, dtype=np.float64), (count, 1))
