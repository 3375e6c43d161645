"""What stays of a gap beside causes, when the small everyday deviations do what they reasonably can."""

from __future__ import annotations

import numpy as np

from realsim.gap.causes.figures import GATE_MEAN, GATE_MEDIAN, REASONABLE
from realsim.gap.causes.fitted import Fit
from realsim.gap.causes.screen import Screen
from realsim.gap.simulation.simulate import Setting
from realsim.types import F64


def deviations(screen: Screen, fit: Fit) -> F64:
    """(atoms,) the most probable everyday deviations beside a fit's causes, none beyond what is reasonable."""
    return reasonable(screen.nuisances(fit.evidence, fit.prior), fit.prior)


def reasonable(x: F64, prior: F64) -> F64:
    """(atoms,) deviations, none larger than a few standard deviations `prior`."""
    return np.clip(x, -REASONABLE * prior, REASONABLE * prior)


def nuisance_settings(screen: Screen, fit: Fit, scale: float = 1.0) -> list[Setting]:
    """The most probable everyday deviations, times `scale`, as settings for the simulator; tiny ones are left out."""
    x = deviations(screen, fit)
    return screen.settings(scale * (fit.evidence.centre + np.where(np.abs(x) > 0.02 * fit.prior, x, 0.0)))


def leftover(screen: Screen, fit: Fit) -> F64:
    """(runs,) mean square in units of the tolerance that stays beside causes and everyday deviations."""
    x = deviations(screen, fit)
    result = []
    for k, run in enumerate(screen.runs):
        simulated = screen.comparison.residual(run, fit.predictions[k])
        moved = simulated - screen.fitted(k, fit.evidence.centre + x - fit.about)
        # Where the linear rest is no good, the simulation itself counts.
        squares = [float(np.nanmean(r**2 / screen.comparison.tolerance(run))) for r in (simulated, moved)]
        result.append(min(squares))
    return np.array(result)


def is_gap(left: F64) -> bool:
    """Whether what stays beside the nuisance parameters (runs,) is more than a floor's worth, in most runs or on the
    whole; a single run near a resonance blows up small deviations."""
    return bool(np.median(left) > GATE_MEDIAN or left.mean() > GATE_MEAN)
