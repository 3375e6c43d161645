"""Interpretation of a recording: the field of each array of a case, with the evidence, and what is missing."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from realsim.core.types import F64
from realsim.gap.recordings.depth import Depth
from realsim.gap.recordings.names import ROLES
from realsim.gap.recordings.recording import Field, Recording, Stream
from realsim.gap.recordings.world import World


@dataclass(frozen=True)
class Candidate:
    """A field that may be some array, by its name or its message type."""

    stream: str
    member: str
    role: str
    """See `realsim.gap.recordings.names.meaning`."""
    unit: str
    why: str

    @property
    def label(self) -> str:
        """How it is named to people and in --use."""
        return f"{self.stream}:{self.member}" if self.stream else self.member


@dataclass(frozen=True)
class Assignment:
    """One array of the case: columns of a field, brought into its order, unit and sign."""

    role: str
    source: Candidate
    columns: tuple[int, ...]
    """Of the field, in the order of `targets`."""
    targets: tuple[str, ...]
    """Joints, actuators, axes or bodies."""
    scale: tuple[float, ...]
    """The array's value = scale * (value in the file - offset)."""
    offset: tuple[float, ...]
    unit: str
    """In which the file is."""
    evidence: tuple[str, ...]
    doubtful: bool = False
    """The evidence does not settle it."""
    threshold: float | None = None
    """Contact: the force above which a foot stands."""

    @property
    def order(self) -> str:
        """Its targets for people, with the signs."""
        return ", ".join(f"{'-' if s < 0 else ''}{name}" for s, name in zip(self.scale, self.targets, strict=True))

    def values(self, field_: Field) -> F64:
        """(T, K) in the contract's order and unit."""
        found = (field_.values[:, list(self.columns)] - np.array(self.offset)) * np.array(self.scale)
        if self.threshold is not None:
            found = np.where(np.isfinite(found), (found > self.threshold).astype(float), np.nan)
        return found

    def as_dict(self) -> dict[str, Any]:
        return {
            "stream": self.source.stream, "field": self.source.member, "columns": list(self.columns),
            "targets": list(self.targets), "unit": self.unit, "scale": list(self.scale), "offset": list(self.offset),
            "threshold": self.threshold, "evidence": list(self.evidence), "doubtful": self.doubtful,
        }  # fmt: skip


@dataclass
class Proposal:
    """A case as it would be written."""

    recordings: list[Recording] = field(repr=False)
    assignments: dict[str, Assignment] = field(default_factory=dict)
    command_kind: str = "position"
    base: str = "fixed"
    jointless: bool = False
    """The model is a free body without joints: a drone."""
    torque_kind: str = "none"
    imu_site: str | None = None
    clocks: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)
    """Fields that no role was found for."""
    model: str = ""
    depth: Depth | None = None
    """Depth frames that go into the case."""
    world: World | None = None
    """How the scene lies, into whose frame base poses are put."""

    @property
    def complete(self) -> bool:
        """Whether a case can be written."""
        return "command" in self.assignments and self.place in self.assignments

    @property
    def place(self) -> str:
        """The array whose samples are the rows of a run: joint positions, of a body without joints its own."""
        return "base_pos" if self.jointless else "joint_pos"

    @property
    def joints(self) -> tuple[str, ...]:
        return self.assignments["joint_pos"].targets if "joint_pos" in self.assignments else ()

    def as_dict(self) -> dict[str, Any]:
        first = self.recordings[0]
        return {
            "recording": str(first.path), "reader": first.reader, "runs": [r.name for r in self.recordings],
            "model": self.model or None, "complete": self.complete, "command_kind": self.command_kind,
            "base": self.base, "torque_kind": self.torque_kind, "imu_site": self.imu_site,
            "arrays": {r: self.assignments[r].as_dict() for r in ROLES if r in self.assignments},
            "clocks": self.clocks, "missing": self.missing, "warnings": self.warnings, "unused": self.unused,
            "skipped": dict(first.skipped), "facts": dict(first.facts),
            "scene": None if self.world is None else str(self.world.scene),
            "depth": None if self.depth is None else {"topic": self.depth.topic, **self.depth.as_dict()},
        }  # fmt: skip

    def render(self) -> str:
        """For a person: what is in it, what it is taken for and why, what is missing."""
        first = self.recordings[0]
        lines = [f"{first.path}: {first.reader}, {_count(len(self.recordings), 'run')}"]
        lines += [f"  {s.name or 'table'}  {s.type}, {s.count} samples{_fields(s)}" for s in first.streams]
        lines += [f"  {name}  not read: {why}" for name, why in list(first.skipped.items())[:12]]
        lines += ["", "taken for"]
        for role in ROLES:
            if role not in self.assignments:
                continue
            found = self.assignments[role]
            doubt = "  (in doubt)" if found.doubtful else ""
            lines.append(f"  {role:<13} {found.source.label}, in {found.unit or 'its own unit'}{doubt}")
            if len(found.targets) > 1 or role in ("command", "joint_pos"):
                lines.append(f"  {'':<13} {found.order}")
            lines += [f"  {'':<13} - {e}" for e in found.evidence]
        if self.world is not None:
            lines.append(f"  {'scene':<13} base poses are put from the world of its capture into {self.world.scene}")
        if self.depth is not None:
            lens = self.depth.source.camera
            lines.append(f"  {'depth':<13} {self.depth.topic}, seen by the model's camera {self.depth.camera}")
            lines.append(f"  {'':<13} - {lens.width}x{lens.height}, focal length {lens.fx:.4g} pixels by camera_info")
        if not self.assignments:
            lines.append("  nothing: neither names nor values identify a field")
        for title, items in (("time", self.clocks), ("missing", self.missing), ("warnings", self.warnings)):
            if items:
                lines += ["", title, *(f"  {item}" for item in items)]
        if self.unused:
            lines += ["", f"not used: {', '.join(self.unused[:24])}{' ...' if len(self.unused) > 24 else ''}"]
        return "\n".join(lines)


def field_of(recording: Recording, source: Candidate) -> tuple[Stream, Field] | None:
    """The stream and field of a candidate in another recording of the same layout."""
    stream = next((s for s in recording.streams if s.name == source.stream), None)
    if stream is None and len(recording.streams) == 1:  # a table is named after its file
        stream = recording.streams[0]
    if stream is None or source.member not in stream.fields:
        return None
    return stream, stream.fields[source.member]


def _fields(stream: Stream) -> str:
    names = [f"{n} ({f.width})" if f.width > 1 else n for n, f in stream.fields.items()]
    return f": {', '.join(names[:10])}{', ...' if len(names) > 10 else ''}"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"
