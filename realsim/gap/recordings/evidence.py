"""State shared by the steps of the inference: the recording, its times, the model, and settled roles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os.path import commonpath
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.recordings.clocks import Clocked, clocked, increasing
from realsim.gap.recordings.model import Target
from realsim.gap.recordings.names import rawness
from realsim.gap.recordings.proposal import Assignment, Candidate, Proposal, field_of
from realsim.gap.recordings.recording import Field, Recording, Stream
from realsim.gap.recordings.signals import MOST, at, held

MOST_RUNS = 12
"""Runs that orders and units are decided by together."""
SAME = 0.9
"""Correlation from which two topics say the same of one robot."""


@dataclass
class Evidence:
    """One recording under inference."""

    recording: Recording
    times: Mapping[str, Clocked]
    target: Target | None
    candidates: Sequence[Candidate]
    chosen: Mapping[str, Candidate | None]
    proposal: Proposal
    recordings: Sequence[Recording] = ()
    """All runs, of which `recording` is one."""
    unordered: bool = False
    """Nothing settles which of the unnamed columns of the positions is which joint."""

    def of(self, source: Candidate) -> tuple[F64, Field]:
        """(time, field) of a candidate, in the order of time."""
        found = field_of(self.recording, source)
        assert found is not None
        stream, field_ = found
        time = self.times[source.stream].time
        if (np.diff(time) > 0).all():
            return time, field_
        time, values = increasing(time, field_.values, stream.type)
        return time, replace(field_, values=values)

    def units(self, source: Candidate, columns: Sequence[int]) -> list[str]:
        """What the file says of each column's unit."""
        units = self.of(source)[1].units
        return [units[c] if units else source.unit for c in columns]

    def stream(self, source: Candidate) -> Stream:
        return next(s for s in self.recording.streams if s.name == source.stream)

    def candidates_for(self, role: str) -> list[Candidate]:
        """Fields that may have this role; what the user named, alone. A role ending in a dot takes all of its kind."""
        plain = role.rstrip(".")
        if plain in self.chosen:
            named = self.chosen[plain]
            return [] if named is None else [named]
        taken = {a.source.label for a in self.proposal.assignments.values()}
        taken |= {c.label for c in self.chosen.values() if c is not None}
        return [
            c for c in self.candidates
            if c.label not in taken and (c.role == plain or (role.endswith(".") and c.role.startswith(role)))
        ]  # fmt: skip

    def ranked(self, found: Sequence[Candidate]) -> list[Candidate]:
        """Candidates for one role: of the stream of the joints or nearest to it by name, then raw ones, then fast."""
        home = self.proposal.assignments.get("joint_pos")
        place = home.source.stream if home else ""
        return sorted(
            found,
            key=lambda c: (
                c.stream != place, -len(Path(commonpath([f"/{t.strip('/')}" for t in (c.stream, place)])).parts),
                rawness(c.member), -len(self.of(c)[0]), c.label
            ),
        )  # fmt: skip

    def nearest(self, found: Sequence[Candidate]) -> Candidate | None:
        """The first of `ranked`."""
        return next(iter(self.ranked(found)), None)

    def warn(self, text: str) -> None:
        """Add to the proposal's warnings."""
        self.proposal.warnings.append(text)

    def settle(
        self, role: str, source: Candidate, columns: Sequence[int], targets: Sequence[str], evidence: Sequence[str], *,
        scale: Any = 1.0, offset: Any = 0.0, unit: str = "",
        doubtful: bool = False, threshold: float | None = None,
    ) -> Assignment:  # fmt: skip
        """Enter an assignment into the proposal."""
        n = len(columns)
        named = any(text.startswith("its columns name") for text in evidence)
        if self.unordered and role in ("command", "joint_vel", "joint_torque") and not named:
            evidence, doubtful = [*evidence, "in the positions' order, which is in doubt"], True
        found = Assignment(
            role, source, tuple(columns), tuple(targets), tuple(np.broadcast_to(scale, n).astype(float).tolist()),
            tuple(np.broadcast_to(offset, n).astype(float).tolist()), unit,
            tuple(e for e in evidence if e not in ("", "by ")), doubtful, threshold,
        )  # fmt: skip
        self.proposal.assignments[role] = found
        return found

    def series(self, role: str) -> tuple[F64, F64] | None:
        """(time, (T, K) in the contract's order and unit) of what is settled, or None."""
        found = self.proposal.assignments.get(role)
        if found is None:
            return None
        time, field_ = self.of(found.source)
        return time, found.values(field_)

    def in_runs(self, source: Candidate, role: str) -> list[tuple[F64, F64, F64]]:
        """(time, (T, A) newest values of a field, (T, B) of a role that is settled) of each run, up to MOST_RUNS."""
        settled = self.proposal.assignments[role]
        found = []
        for recording in self.recordings[:MOST_RUNS] or [self.recording]:
            raw, home = field_of(recording, source), field_of(recording, settled.source)
            if raw is None or home is None or max(settled.columns) >= home[1].width:
                continue
            times = self.times if recording is self.recording else clocked(recording)
            t, values = increasing(times[raw[0].name].time, raw[1].values, raw[0].type)
            place, done = increasing(times[home[0].name].time, settled.values(home[1]), home[0].type)
            found.append((place, held(t, values, place), done))
        return found

    def beside(self, role: str, times: F64) -> F64 | None:
        """(T, K) of what is settled, at other times."""
        found = self.series(role)
        return None if found is None else at(found[0], found[1], times)

    def same_robot(self, a: Candidate, b: Candidate) -> bool:
        """Whether two fields of equal width say the same."""
        (ta, fa), (tb, fb) = self.of(a), self.of(b)
        if fa.width != fb.width:
            return True
        other = at(tb, fb.values, ta[:MOST])
        found = [alike(fa.values[:MOST, k], other[:, k]) for k in range(fa.width)]
        moving = [f for f, k in zip(found, range(fa.width), strict=True) if np.nanstd(fa.values[:, k]) > 1e-3]
        return not moving or float(np.median(moving)) > SAME or not np.isfinite(other).any()
