"""What stays of a gap beside causes, when the small everyday deviations do what they reasonably can."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.inference.causes.fitted import Fit
from realsim.gap.inference.likelihood.linear import bounded
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Setting


def deviations(screen: Screen, fit: Fit) -> F64:
    """(atoms,) the most probable everyday deviations beside a fit's causes. What is beyond reason of one is cut off
    and not taken over by others: a log that needs it has a gap, which they would hide."""
    A, b, prior = np.sum(fit.evidence.A, axis=0), np.sum(fit.evidence.b, axis=0), fit.prior / fit.scale
    most, (free, _) = figures.REASONABLE * prior, bounded(A, b, prior, np.inf)
    return np.clip(free, -most, most)


def nuisance_settings(screen: Screen, fit: Fit, scale: float = 1.0) -> list[Setting]:
    """The most probable everyday deviations, times `scale` as settings for the simulator; tiny ones are left out."""
    x = deviations(screen, fit)
    x = fit.evidence.centre + np.where((np.abs(x) > 0.02 * fit.prior) & ~screen.stiff, x, 0.0)
    return screen.settings(scale * x)


def leftover(screen: Screen, fit: Fit) -> F64:
    """(runs,) mean square in units of the tolerance that stays beside causes and everyday deviations."""
    rows = zip(screen.runs, rests(screen, fit), strict=True)
    tolerance, weights = screen.comparison.tolerance, fit.conditions.weights
    return np.array([float(np.nanmean(r**2 / tolerance(run, weights))) for run, r in rows])


def rests(screen: Screen, fit: Fit) -> list[F64]:
    """(B, C) a run: residual beside causes and everyday deviations."""
    x = fit.evidence.centre + deviations(screen, fit) - fit.about
    return [screen.residual(k, y, x) for k, y in enumerate(fit.predictions)]


def is_gap(left: F64) -> bool:
    """Whether what stays beside the nuisance parameters (runs,) is more than a floor's worth, in most runs or on the
    whole; a single run near a resonance blows up small deviations."""
    return bool(np.median(left) > figures.GATE_MEDIAN or left.mean() > figures.GATE_MEAN)
