"""A proposal as a case folder (docs/diagnose.md): log.json, model.xml with its files, runs/*.npz, and why."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, RealsimError
from realsim.core.files import (
    check_size,
    explain_write_errors,
    inside,
    output_folder,
    read_bytes,
    to_json,
    write_bytes,
    write_text,
)
from realsim.core.types import F64
from realsim.gap.recordings.clocks import clocked, increasing
from realsim.gap.recordings.depth import write_frames
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.proposal import Assignment, Proposal, field_of
from realsim.gap.recordings.recording import Recording, planned
from realsim.gap.recordings.signals import at, held
from realsim.gap.recordings.vocabulary import plain

LEAST_SAMPLES = 20
MAX_ASSET_BYTES = 512 * 2**20
SETTLED = 1e-3
"""s of difference up to which commands and positions count as sampled together."""


def write_case(
    proposal: Proposal,
    target: Target,
    out: Path,
    *,
    overwrite: bool = False,
    check: Callable[[Path], object] | None = None,
) -> list[str]:
    """Write the case; returns notes on its runs.

    Args:
        check: reads the finished folder, such as `realsim.gap.load_case`. What it refuses is not left behind.

    Raises:
        GapError: no command or no positions, or no run that has them; what `check` says.
    """
    if not proposal.complete:
        raise GapError(
            "the case is not complete",
            file=proposal.recordings[0].path,
            expected="a command and joint positions",
            found=f"{'; '.join(proposal.missing[:2])}; recorded: {_recorded(proposal)}",
            hint="see `realsim log` without --out; --use ROLE=STREAM:FIELD names a field",
        )
    said: list[str] = []
    with output_folder(out, overwrite=overwrite, source=proposal.recordings[0].path) as work:
        (work / "runs").mkdir()
        written: dict[str, int] = {}
        for recording in proposal.recordings:
            try:
                run = run_arrays(proposal, recording)
            except GapError as error:
                said.append(f"{recording.name} is left out: {error.message}")
                continue
            name = _unique(plain(recording.name) or "run", written)
            buffer = io.BytesIO()
            np.savez_compressed(buffer, allow_pickle=False, **run.arrays)
            write_bytes(work / "runs" / f"{name}.npz", buffer.getvalue())
            notes = list(run.notes)
            if proposal.depth is not None:
                folder = work / "runs" / f"{name}_depth"
                notes += write_frames(proposal.depth, recording, run.frames, run.span, folder)
            said += [f"{name}: {n}" for n in notes]
        if not written:
            raise GapError("no run can be written", file=proposal.recordings[0].path, found="; ".join(said[:4]))
        log = _log(proposal, said)
        if proposal.depth is not None and any((work / "runs").glob("*_depth")):
            log["depth_camera"] = proposal.depth.as_dict()
            said += proposal.depth.doubts()
        write_text(work / "log.json", to_json(log))
        write_text(work / "proposal.json", to_json(proposal.as_dict() | {"runs_said": said}))
        _write_model(target, work)
        try:
            if check is not None:
                check(work)
        except GapError as error:
            found = "; ".join(filter(None, [error.found, *proposal.warnings[:2]]))
            raise GapError(
                error.message, file=proposal.recordings[0].path, expected=error.expected, found=found, hint=error.hint
            ) from error
    return said


def _recorded(proposal: Proposal) -> str:
    """Streams of the recordings, each once, and what was not read."""
    names = dict.fromkeys(f"{s.name or 'table'} ({s.type})" for r in proposal.recordings for s in r.streams)
    names |= dict.fromkeys(f"{t} (not read: {why})" for r in proposal.recordings for t, why in r.skipped.items())
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return (", ".join(list(names)[:8]) or "nothing") + more


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
    for role in ("joint_pos", "command"):
        if role not in series:
            raise GapError(
                f"{role} is not in the run", file=recording.path, expected=proposal.assignments[role].source.label
            )
    place, sent = series["joint_pos"][0], series["command"][0]
    start, end = max(place[0], sent[0]), place[-1]
    rows, notes = _rows(place, sent, start, end)
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
        elif role == "contact":
            arrays[role] = held(time, values, rows)
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
        return rows, []
    return np.union1d(rows, inner), [
        f"commands come {1e3 * np.median(late):.3g} ms before the next position: they have rows of their own"
    ]


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


def _log(proposal: Proposal, said: list[str]) -> dict[str, Any]:
    sources = ", ".join(f"{r}: {a.source.label}" for r, a in proposal.assignments.items())
    return {
        "joint_names": list(proposal.assignments["joint_pos"].targets),
        "actuator_names": list(proposal.assignments["command"].targets),
        "command_kind": proposal.command_kind,
        "command_hold": "zoh",
        "base": proposal.base,
        "torque_kind": proposal.torque_kind,
        "imu_site": proposal.imu_site,
        "contact_bodies": list(proposal.assignments["contact"].targets) if "contact" in proposal.assignments else [],
        "notes": f"written by realsim log from {proposal.recordings[0].path.name} ({sources}); see proposal.json",
    }


def _unique(name: str, taken: dict[str, int]) -> str:
    taken[name] = taken.get(name, 0) + 1
    return name if taken[name] == 1 else f"{name}_{taken[name]}"


def _write_model(target: Target, work: Path) -> None:
    """model.xml as it is, where its files lie below it; else with its files beside it, under names of their own."""
    spec, home = target.spec, target.path.parent
    named = [(e, e.file, d) for e, d in _assets(spec) if e.file]
    plain_text = target.path.suffix.lower() == ".xml" and b"<include" not in (text := read_bytes(target.path))
    if plain_text and not named and b"<mujoco" in text:
        write_bytes(work / "model.xml", text)
        return
    total = 0
    for number, (element, file, folder) in enumerate(named):
        source = (home / folder / file).resolve()
        try:
            check_size(source, MAX_ASSET_BYTES)
        except RealsimError as error:
            raise GapError(
                "a file of the model cannot be read", file=target.path, found=f"{file}: {error.message}"
            ) from error
        total += source.stat().st_size
        if total > MAX_ASSET_BYTES:
            raise GapError(
                "the model's files are too large", file=target.path, expected=f"{MAX_ASSET_BYTES} bytes in all"
            )
        name = f"assets/{number:03d}_{plain(source.stem)[:40]}{source.suffix.lower()}"
        place = inside(work, name)
        with explain_write_errors(place):
            place.parent.mkdir(exist_ok=True)
            shutil.copyfile(source, place)
        element.file = name
    spec.meshdir = spec.texturedir = ""
    write_text(work / "model.xml", spec.to_xml())


def _assets(spec: Any) -> list[tuple[Any, str]]:
    """Meshes, height fields and textures with the folder that their names are relative to."""
    found = [(m, spec.meshdir) for m in (*spec.meshes, *spec.hfields)]
    return found + [(t, spec.texturedir) for t in spec.textures]
