"""A proposal as a case folder (docs/diagnose.md): log.json, model.xml with its files, runs/*.npz, and why."""

import io
import shutil
from collections.abc import Callable
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
from realsim.core.types import MjSpec
from realsim.gap.recordings.arrays import run_arrays
from realsim.gap.recordings.depth import write_frames
from realsim.gap.recordings.model import NO_SERVOS, Target
from realsim.gap.recordings.page import recording_page
from realsim.gap.recordings.proposal import Proposal
from realsim.gap.recordings.vocabulary import plain

MAX_ASSET_BYTES = 512 * 2**20


def write_case(
    proposal: Proposal,
    target: Target,
    out: Path | str,
    *,
    overwrite: bool = False,
    check: Callable[[Path], object] | None = None,
) -> list[str]:
    """Write the case; returns notes on its runs.

    Args:
        check: reads the finished folder, such as `realsim.gap.load_case`. What it refuses is not left behind.

    Raises:
        GapError: no command or no positions, no run that has them, a model without actuators; what `check` says.
    """
    if not proposal.complete:
        raise GapError(
            "the case is not complete",
            file=proposal.recordings[0].path,
            expected="a command and joint positions, or the position of a body without joints",
            found=f"{'; '.join(proposal.missing[:2])}; recorded: {_recorded(proposal)}",
            hint="`realsim log` without --out shows what was understood; --use ROLE=FIELD (or COLUMN,...) names it",
        )
    if not target.actuators:
        raise GapError(
            "the model has no actuators", file=target.path, expected="the robot's servos",
            hint=f"realsim log ... {NO_SERVOS}",
        )  # fmt: skip
    remarks: list[str] = []
    with output_folder(Path(out), overwrite=overwrite, source=proposal.recordings[0].path) as work:
        (work / "runs").mkdir()
        written: dict[str, int] = {}
        for recording in proposal.recordings:
            try:
                run = run_arrays(proposal, recording)
            except GapError as error:
                remarks.append(f"{recording.name} is left out: {error.message}")
                continue
            name = _unique(plain(recording.name) or "run", written)
            buffer = io.BytesIO()
            np.savez_compressed(buffer, allow_pickle=False, **run.arrays)
            write_bytes(work / "runs" / f"{name}.npz", buffer.getvalue())
            notes = list(run.notes)
            if proposal.depth is not None:
                folder = work / "runs" / f"{name}_depth"
                notes += write_frames(proposal.depth, recording, run.frames, run.span, folder)
            remarks += [f"{name}: {n}" for n in notes]
        if not written:
            raise GapError("no run can be written", file=proposal.recordings[0].path, found="; ".join(remarks[:4]))
        log = _log(proposal, remarks)
        if proposal.depth is not None and any((work / "runs").glob("*_depth")):
            log["depth_camera"] = proposal.depth.as_dict()
            remarks += proposal.depth.doubts()
        write_text(work / "log.json", to_json(log))
        write_text(work / "proposal.json", to_json(proposal.as_dict() | {"runs_said": remarks}))
        write_text(work / "log.html", recording_page(proposal, target, remarks))
        _write_model(target, work)
        try:
            if check is not None:
                check(work)
        except GapError as error:
            found = "; ".join(filter(None, [error.found, *proposal.warnings[:2]]))
            raise GapError(
                error.message, file=proposal.recordings[0].path, expected=error.expected, found=found, hint=error.hint
            ) from error
    return remarks


def _recorded(proposal: Proposal) -> str:
    """Streams of the recordings, each once, and what was not read."""
    names = dict.fromkeys(f"{s.name or 'table'} ({s.type})" for r in proposal.recordings for s in r.streams)
    names |= dict.fromkeys(f"{t} (not read: {why})" for r in proposal.recordings for t, why in r.skipped.items())
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return (", ".join(list(names)[:8]) or "nothing") + more


def _log(proposal: Proposal, remarks: list[str]) -> dict[str, Any]:
    sources = ", ".join(f"{r}: {a.source.label}" for r, a in proposal.assignments.items())
    return {
        "joint_names": list(proposal.joints),
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
    spec.modelfiledir = str(work)  # a URDF reads its meshes anew to be written
    write_text(work / "model.xml", spec.to_xml())


def _assets(spec: MjSpec) -> list[tuple[Any, str]]:
    """Meshes, height fields and textures with the folder that their names are relative to."""
    found = [(m, spec.meshdir) for m in (*spec.meshes, *spec.hfields)]
    return found + [(t, spec.texturedir) for t in spec.textures]
