"""The verdict, with its reasons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from realsim.gap.answer.heldout import Shrinkage
from realsim.gap.causes.fit import Fit
from realsim.gap.causes.leftover import is_gap, leftover
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.select import Selection
from realsim.gap.config import DiagnoseConfig
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

FAR_ABOVE = 20.0
"""Mean square in units of the floor from which on a rest is no matter of tolerances."""
EXCESS = 1.5
"""Where no cause takes any of it, a rest must be larger than else by this factor to be called a gap."""
NOT_HELD = 0.3
"""Share of the gap on unseen runs that may stay at most; causes that hold leave a few per cent."""
STAYS = 15.0
"""Mean square in units of the floor that may stay, all runs but the worst together, however small a share of the
gap it is: of large gaps too, the right causes leave hardly anything."""

CERTAIN = 0.86
"""Largest probability: of identified causes 138 of 160 were right on withheld logs. What is clear beyond noise may
still be the imitation of something else."""
IMITATION = 0.5
"""Factor on it where a gap stays unexplained: what the library lacks looks in part like something it holds."""


@dataclass(frozen=True)
class Judgement:
    verdict: str
    unexplained: float
    probabilities: list[float]
    """By cause of the fit, in the fit's order."""
    reasons: tuple[str, ...]
    at_an_end: tuple[str, ...] = ()
    """Strengths of an unexplained gap's causes that lie at an end of their range."""


def judge(config: DiagnoseConfig, screen: Screen, selection: Selection, shrunk: Shrinkage) -> Judgement:
    """No gap, identified, ambiguous or unexplained, with the reasons."""
    reasons = []
    fit = selection.fit
    first, left, unexplained = remains(screen, selection)
    gains = [float(np.clip(selection.gains.get(i, 0.0), -30.0, 30.0)) for i in range(len(fit.causes))]
    probabilities = [float(CERTAIN / (1 + np.exp(5 - g))) for g in gains]
    gap = is_gap(left)
    if not fit.causes:
        reasons.append(f"{left.mean():.2f} times the floor stays beside the small deviations (nominal {first:.1f})")
        if is_gap(left / EXCESS):
            return Judgement("unexplained", max(unexplained, 0.5), probabilities, tuple(reasons))
        return Judgement("no_gap", 0.0, probabilities, tuple(reasons))
    reasons.append(f"{first:.1f} -> {left.mean():.2f} in units of the floor")
    limit = config.unexplained_share * (0.5 if left.mean() > FAR_ABOVE else 1.0)
    failed = not_held(shrunk.before_over_floor, shrunk.after_over_floor) if shrunk.unseen else 0.0
    ends = at_an_end(screen, fit)
    doubt = ""
    if gap and unexplained > limit:
        doubt = f"{unexplained:.0%} of the gap stays"
    elif (stays := _but_the_worst(left)) > STAYS:
        doubt = f"{stays:.0f} times the floor stays: of large gaps too, the right causes leave hardly anything"
    elif failed:
        doubt, unexplained = f"{failed:.0%} of the gap stays on unseen runs", max(unexplained, failed)
    elif ends:
        doubt = f"{', '.join(ends)}: as far as the library goes, so it stands for something else"
    if doubt:
        probabilities = [IMITATION * (1 - unexplained) * p for p in probabilities]
        return Judgement("unexplained", unexplained, probabilities, (*reasons, doubt), tuple(ends))
    if selection.equivalent:
        count = 1 + len(selection.equivalent)
        probabilities = [max(p / count, 0.5) for p in probabilities]
        return Judgement("ambiguous", unexplained, probabilities, tuple(reasons))
    return Judgement("identified", unexplained, probabilities, tuple(reasons))


def _but_the_worst(left: F64) -> float:
    """Mean of what stays, without the run that may have diverged where there are several."""
    return float(np.sort(left)[: max(len(left) - 1, 1)].mean())


def at_an_end(screen: Screen, fit: Fit) -> list[str]:
    """Strengths at an end of their range; a law's shape may be at one, as where dry friction has no dip."""
    strengths = {
        p.name
        for c in fit.causes
        for p in lookup(c.candidate.effect).parameters(screen.simulator.context, c.candidate.place)
        if p.strength
    }
    return [name for name in fit.at_bounds if name in strengths]


def not_held(before: float, after: float) -> float:
    """Share of the gap that stays, at most 1; 0 where that is little, or no more than tolerances.

    Args:
        before, after: mean squares on unseen runs in units of the floor, without and with the causes.
    """
    share = after / max(before, 1e-9)
    return min(share, 1.0) if after > FAR_ABOVE and share > NOT_HELD else 0.0


def remains(screen: Screen, selection: Selection) -> tuple[float, F64, float]:
    """(nominal, final, share): mean squares in units of the floor, and the share of the gap above it that stays.

    The final one is after causes and small deviations. The share is taken run by run, so that one run that diverges
    does not speak for all.
    """
    before = []
    for k, run in enumerate(screen.runs):
        r0 = screen.comparison.residual(run, screen.nominal[k])
        before.append(float(np.nanmean(r0**2 / screen.comparison.floor(run))))
    a, b = leftover(screen, selection.fit), np.array(before)
    weight = np.log1p(np.maximum(b - 1, 0))
    shares = np.clip((a - 1) / np.maximum(b - 1, 1e-9), 0, 1)
    share = float((weight * shares).sum() / weight.sum()) if weight.sum() > 0 else 0.0
    return float(b.mean()), a, share
