"""The verdict: from the posterior over sets of causes, and from a check on a run that nothing was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from realsim.gap.selection.figures import CERTAIN, CREDIBLE, EXPLAINED, HELD_SHARE, MOST_SETS
from realsim.gap.selection.fitting import Fit, Slot
from realsim.gap.selection.select import Posterior


class Verdict(StrEnum):
    NO_GAP = "no_gap"
    IDENTIFIED = "identified"
    AMBIGUOUS = "ambiguous"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Check:
    """One signal on the runs of the check, in its own unit."""

    signal: str
    motion: float
    """Standard deviation of the measurement over time: how large the motion is."""
    before: float
    """Root mean square error of the nominal simulator."""
    after: float
    """The same with the causes and the most probable everyday deviations."""
    floor: float
    """What sensors and a good simulator's details leave."""


@dataclass(frozen=True)
class Judgement:
    verdict: Verdict
    probabilities: dict[Slot, float]
    """Of every cause, summed over the sets that have it."""
    alternatives: tuple[Fit, ...]
    """Other sets that are as probable, where the verdict is ambiguous."""
    removed: float
    """Share of the squared error above the floor that is gone in the check."""
    stays: float
    """Mean square that stays in the check, in units of the floor."""
    reason: str


def judge(posterior: Posterior, checks: list[Check], at_bounds: tuple[str, ...]) -> Judgement:
    """No gap, one set, several, a set that leaves much, or none.

    Args:
        at_bounds: strengths of the best set that lie at an end of their range: it stands for something else.
    """
    best = posterior.fits[0]
    probabilities: dict[Slot, float] = {}
    for fit, p in zip(posterior.fits, posterior.probabilities, strict=True):
        for slot in fit.named:
            probabilities[slot] = probabilities.get(slot, 0.0) + p
    before = float(np.mean([(c.before / c.floor) ** 2 for c in checks]))
    after = float(np.mean([(c.after / c.floor) ** 2 for c in checks]))
    removed = 1 - max(after - 1, 0.0) / max(before - 1, 1e-9) if before > 1 else 0.0
    others = _credible(posterior) if best.causes else ()
    if after <= EXPLAINED and not at_bounds:
        if not best.causes:
            verdict, reason = Verdict.NO_GAP, f"no cause is more probable than none ({posterior.probabilities[0]:.2f})"
        elif min(probabilities[s] for s in best.named) >= CERTAIN:
            verdict, reason, others = Verdict.IDENTIFIED, "every cause is certain", ()
        else:
            verdict, reason = Verdict.AMBIGUOUS, f"{1 + len(others)} sets share the probability"
    elif best.causes and removed >= HELD_SHARE and not at_bounds:
        verdict, reason = Verdict.PARTLY_EXPLAINED, f"{after:.1f} times the floor stays"
    else:
        verdict, reason = Verdict.UNEXPLAINED, f"{1 - removed:.0%} of the error stays, {after:.1f} times the floor"
        reason += "".join(f"; {name} is as far as it goes" for name in at_bounds)
    return Judgement(verdict, probabilities, tuple(others), removed, after, reason)


def _credible(posterior: Posterior) -> tuple[Fit, ...]:
    """The sets beside the best that belong to the credible ones and contain no other of them."""
    found: list[Fit] = []
    total = posterior.probabilities[0]
    for fit, p in zip(posterior.fits[1:], posterior.probabilities[1:], strict=True):
        if total >= CREDIBLE or len(found) >= MOST_SETS:
            break
        total += p
        if fit.causes and not any(f.named < fit.named for f in [posterior.fits[0], *found]):
            found.append(fit)
    return tuple(found)
