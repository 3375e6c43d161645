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
    further = fit.evidence.centre + deviations(screen, fit) - fit.about
    simulated: list[float] = []
    moved: list[float] = []
    for k, run in enumerate(screen.runs):
        r = screen.comparison.residual(run, fit.predictions[k])
        for found, rest in ((simulated, r), (moved, r - screen.fitted(k, further))):
            found.append(float(np.nanmean(rest**2 / screen.comparison.tolerance(run))))
    # The most probable deviations are linear about those that were simulated. A robot has one set of them in all runs:
    # where the linear ones leave more on the whole, they are beyond what slopes can tell, and the simulated ones count.
    return np.array(min(moved, simulated, key=np.mean))


def is_gap(left: F64) -> bool:
    """Whether what stays beside the nuisance parameters (runs,) is more than a floor's worth, in most runs or on the
    whole; a single run near a resonance blows up small deviations."""
    return bool(np.median(left) > GATE_MEDIAN or left.mean() > GATE_MEAN)
