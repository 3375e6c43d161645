"""One run of a recording as the arrays of a case, in the contract's names, order and units."""

from dataclasses import dataclass

import numpy as np

from realsim.core.errors import GapError
from realsim.core.types import F64, Bool
from realsim.gap.case.runs import GAP, LONGEST_STEP, SHORTEST_GAP, find_gaps, usual_step
from realsim.gap.recordings.clocks import clocked, increasing
from realsim.gap.recordings.proposal import Assignment, Proposal, field_of
from realsim.gap.recordings.recording import Recording, planned
from realsim.gap.recordings.signals import at, held

LEAST_SAMPLES = 20
LONGEST_HOLD = 5.0
"""s that the last command may be older than the first position."""
SETTLED = 1e-3
"""s of difference up to which commands and positions count as sampled together."""


@dataclass(frozen=True)
class RunArrays:
    """One run of a case."""

    arrays: dict[str, F64]
    notes: list[str]
    span: tuple[float, float]
    """s of its first and last row on the recording's clock."""
    frames: F64
    """(N,) s of the depth frames on the same clock."""


def run_arrays(proposal: Proposal, recording: Recording) -> RunArrays:
    """The arrays of one run in the contract's names, order and units, on the times of its joint positions.

    Where commands were sent at other moments, these are rows too, so that no command is late by up to a sample: joint
    signals are missing (NaN) in such rows. Commands are held; all else is interpolated between its own samples.

    Raises:
        GapError: the run lacks the command or the positions, or they do not overlap in time.
    """
    times = clocked(recording)
    series: dict[str, tuple[F64, F64, str]] = {}
    for role, assignment in proposal.assignments.items():
        found = field_of(recording, assignment.source)
        if found is not None and _fits(assignment, found[1].width):
            stream, field = found
            time, values = increasing(times[stream.name].time, assignment.values(field), stream.type)
            series[role] = time, values, stream.type
    for role in (proposal.place, "command"):
        if role not in series:
            raise GapError(
                f"{role} is not in the run", file=recording.path, expected=proposal.assignments[role].source.label
            )
    place, sent = series[proposal.place][0], series["command"][0]
    if place[-1] < sent[0] or sent[-1] < place[0] - LONGEST_HOLD:
        raise GapError(
            "commands and positions do not overlap in time", file=recording.path,
            expected="clocks that agree, or time stamps of one clock in both",
            found=f"commands {sent[0]:.6g} to {sent[-1]:.6g} s, positions {place[0]:.6g} to {place[-1]:.6g} s",
            hint="record both with one clock; --use time=COLUMN chooses another column of a table as its clock",
        )  # fmt: skip
    start, end = max(place[0], sent[0]), place[-1]
    rows, notes = _rows(place, sent, start, end)
    if not planned(series["command"][2]):
        known = _known(sent, series["command"][1], rows)
        if lost := int((~known).sum()):
            notes.append(f"{lost} positions come where commands were not recorded: they are left out")
        rows = rows[known]
    if len(rows) < LEAST_SAMPLES:
        raise GapError(
            "commands and positions hardly overlap in time", file=recording.path,
            expected=f"at least {LEAST_SAMPLES} samples of both", found=str(len(rows)),
        )  # fmt: skip
    arrays: dict[str, F64] = {"time": rows - rows[0]}
    own = np.isin(rows, place)
    for role, (time, values, kind) in series.items():
        if role == "command":
            arrays[role] = _commanded(time, values, kind, rows)
        elif role == "enabled":
            arrays[role] = np.nan_to_num(held(time, values, rows), nan=1.0)
        elif role in ("contact", "policy_command"):
            arrays[role] = held(time, values, rows)
            if role == "policy_command" and not np.isfinite(arrays[role]).all():
                notes.append("policy_command is missing in some rows: the velocity command of this run is estimated")
        elif role in ("joint_pos", "joint_vel", "joint_torque"):
            arrays[role] = np.where(own[:, None], at(time, values, rows), np.nan)
        elif role == "base_quat":
            arrays[role] = _normalised(at(time, _continuous(values), rows))
        else:
            arrays[role] = at(time, values, rows)
    if proposal.torque_kind == "none":
        arrays.pop("joint_torque", None)
    if proposal.world is not None:
        arrays["base_pos"] = proposal.world.place(arrays["base_pos"])
        if "base_quat" in arrays:
            arrays["base_quat"] = proposal.world.turn(arrays["base_quat"])
    frames = times.get(proposal.depth.topic) if proposal.depth is not None else None
    return RunArrays(arrays, notes, (float(rows[0]), float(rows[-1])), np.zeros(0) if frames is None else frames.time)


def _rows(place: F64, sent: F64, start: float, end: float) -> tuple[F64, list[str]]:
    rows = place[(place >= start) & (place <= end)]
    if len(rows) < 2:
        return rows, []
    inner = sent[(sent > rows[0]) & (sent <= rows[-1])]
    after = np.clip(np.searchsorted(rows, inner), 1, len(rows) - 1)
    late = rows[after] - inner
    if not len(inner) or np.median(np.minimum(late, inner - rows[after - 1])) < SETTLED:
        return np.union1d(rows, inner[np.isin(after, find_gaps(rows))]), []  # positions were lost, commands were not
    return np.union1d(rows, inner), [
        f"commands come {1e3 * np.median(late):.3g} ms before the next position: they have rows of their own"
    ]


def _known(sent: F64, values: F64, rows: F64) -> Bool:
    """(R,) rows whose command is known: those within a gap of a steady stream of commands, which differ before and
    after it, are not, nor those after its end. Single goals hold until the next one."""
    usual, known = usual_step(sent), np.ones(len(rows), bool)
    if not 0 < usual < LONGEST_STEP:
        return known
    for k in find_gaps(sent):
        if not np.allclose(values[k - 1], values[k], equal_nan=True):
            known &= (rows <= sent[k - 1] + usual) | (rows > sent[k] - SETTLED)
    return known & (rows <= sent[-1] + max(GAP * usual, SHORTEST_GAP))


def _commanded(time: F64, values: F64, kind: str, rows: F64) -> F64:
    """Held, from the row on which it nearly falls; between the points of a trajectory message, a straight line."""
    if not planned(kind):
        step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
        return held(time - min(SETTLED, 0.25 * step), values, rows)
    inner = np.stack([np.interp(rows, time, values[:, k]) for k in range(values.shape[1])], axis=1)
    return np.where((rows >= time[0])[:, None], inner, np.nan)


def _fits(assignment: Assignment, width: int) -> bool:
    return max(assignment.columns, default=-1) < width


def _continuous(quat: F64) -> F64:
    """Quaternions without changes of sign from one sample to the next, so that between two lies neither."""
    flips = np.ones(len(quat))
    dots = (quat[1:] * quat[:-1]).sum(axis=1)
    flips[1:] = np.where(dots < 0, -1.0, 1.0)
    return quat * np.cumprod(flips)[:, None]


def _normalised(quat: F64) -> F64:
    return quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-9)
