"""Rows of the ranking table: what was screened or fitted at which stage, and what became of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from realsim.gap.causes.fitted import Fit
from realsim.gap.causes.screen import Candidate
from realsim.types import F64


@dataclass(frozen=True)
class Trial:
    """A further cause beside a set."""

    effect: str
    place: tuple[str, ...]
    names: tuple[str, ...]
    stage: int
    """Causes of the set."""
    linear_gain: float
    """Log-evidence gain by the linear screen."""
    gain: float | None = None
    """Gain after the nonlinear fit, or None if it was not fitted."""
    heldout_gain: float | None = None
    heldout_se: float | None = None
    values: dict[str, float] = field(default_factory=dict)
    outcome: str = "refitted"


def screened(order: Sequence[tuple[float, Candidate, F64]]) -> list[Trial]:
    """A row for the best place of every effect, by the linear screen alone."""
    best: dict[str, Trial] = {}
    for gain, c, _ in order:
        best.setdefault(c.effect, Trial(c.effect, c.place, c.names, 0, gain, outcome="screened"))
    return list(best.values())


def trial(before: Fit, fit: Fit, foretold: float) -> Trial:
    c = fit.causes[-1]
    where = (c.candidate.effect, c.candidate.place, c.candidate.names)
    return Trial(*where, len(before.causes), foretold, before.misfit - fit.misfit, values=c.named)


def with_outcome(
    trials: Sequence[Trial], fit: Fit, outcome: str, held: tuple[float, float, float] | None
) -> list[Trial]:
    """The rows, the last one of this fit's last cause with its outcome and its gain on runs left out in turn."""
    found = list(trials)
    last = fit.causes[-1].candidate.key if fit.causes else None
    for i in reversed(range(len(found))):
        if (found[i].effect, found[i].place, found[i].names) == last:
            mean, error, _ = held or (None, None, None)
            found[i] = replace(found[i], outcome=outcome, heldout_gain=mean, heldout_se=error)
            break
    return found
