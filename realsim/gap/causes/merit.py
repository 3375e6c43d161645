"""What a fit is worth: its price, its gain on unseen runs, how far it exceeds everyday deviations."""

from __future__ import annotations

import numpy as np

from realsim.gap.causes.fit import Cause, Fit
from realsim.gap.causes.leftover import reasonable
from realsim.gap.causes.screen import Screen
from realsim.gap.simulation.simulate import lookup
from realsim.types import F64

GATE_MEDIAN, GATE_MEAN = 1.4, 2.8
"""Mean square in units of the floor, over runs, above which there is a gap."""
FAR_ABOVE = 20.0
"""Mean square in units of the floor from which on a rest is no matter of tolerances."""
PRICE = 4.0
"""Log-likelihood that a parameter must bring: half a log of the data, in round numbers."""
SHARED = 0.5
"""Log-likelihood that a value at several places must bring: where it does nothing at one more, it is no cause there."""
NO_BETTER, HARDLY_BETTER = 12.0, 0.2
"""Log-likelihood by which a law must beat a plainer one that it contains, and share of what that removes by which it
must do so where feet slip and land: what a law leaves is more than noise there, and a richer one bends to it."""
CLEARLY = 5.0
"""Difference in price from which on other causes take the place of those that were found first."""


def complexity(screen: Screen, fit: Fit) -> float:
    """Half a log of the data for every parameter that the data determine (a force across a planar arm is none)."""
    total, errors = 0.0, np.diag(fit.covariance)
    for cause in fit.causes:
        effect = lookup(cause.candidate.effect)
        steps = {p.name: p.step for p in effect.parameters(screen.simulator.context, cause.candidate.place)}
        sizes = np.array([2 * steps[n] for n in cause.candidate.names])
        total += float(np.clip(1 - errors[: len(sizes)] / sizes**2, 0.0, 1.0).sum())
        errors = errors[len(sizes) :]
    return PRICE * total


def price(screen: Screen, fit: Fit) -> float:
    """What a fit costs in log-likelihood, its parameters included: of rivals the cheapest is the best."""
    return fit.misfit + complexity(screen, fit) + SHARED * sum(len(c.candidate.places) > 1 for c in fit.causes)


def no_better(screen: Screen, removed: float) -> float:
    """Log-likelihood up to which a richer law is no better than a plain one, of `removed` by the better of the two."""
    return max(NO_BETTER, HARDLY_BETTER * removed if screen.simulator.context.touches else 0.0)


def holds(mean: float, error: float, positive: float) -> bool:
    """Whether unseen runs gain: most of them, and on balance (runs excite an effect to very different degrees)."""
    return mean > 0.5 * error and positive >= 0.6


def is_gap(left: F64) -> bool:
    """Whether what stays beside everyday deviations is more than a floor's worth, in most runs or on the whole.

    A single run near a resonance blows up small deviations, so one moderate outlier is no gap.
    """
    return bool(np.median(left) > GATE_MEDIAN or left.mean() > GATE_MEAN)


def deviation(screen: Screen, cause: Cause) -> float:
    """Size of a cause in everyday deviations of its kind (or in tenths of a step, where there are none)."""
    effect = lookup(cause.candidate.effect)
    parameters = {p.name: p for p in effect.parameters(screen.simulator.context, cause.candidate.place)}
    sizes = []
    for name, value in cause.named.items():
        p = parameters[name]
        if p.strength:
            sizes.append(abs(value) / (p.nuisance or 0.1 * abs(p.step)))
    return float(np.sqrt(np.sum(np.square(sizes)))) if sizes else 0.0


def total_gap(screen: Screen, current: Fit) -> float:
    """Mean misfit a run that the current causes leave: what a further cause could gain."""
    return current.misfit / len(screen.runs)


def heldout(screen: Screen, before: Fit, after: Fit) -> tuple[float, float, float]:
    """(mean, standard error, share positive) of the gain on each run when the nuisances are fitted on the others.

    Without a cause, the everyday deviation of its own kind may not take its place at an absurd size.
    """
    count = len(screen.runs)
    if count == 1:
        gain = before.misfit - after.misfit
        return gain, gain / 4, 1.0
    gains = []
    for k in range(count):
        others = [i for i in range(count) if i != k]
        gains.append(_unseen(screen, before, after, others, k) - _unseen(screen, after, before, others, k))
    g = np.array(gains)
    return float(g.mean()), float(g.std(ddof=1) / np.sqrt(count)), float((g > 0).mean())


def _unseen(screen: Screen, fit: Fit, rival: Fit, others: list[int], k: int) -> float:
    e = fit.evidence
    x = screen.nuisances(e, fit.prior, others)
    theirs = (fit.prior > 0) & (rival.prior == 0)  # a cause is not a deviation at the same time
    x = np.where(theirs, reasonable(x, fit.prior), x)
    return 0.5 * float(e.c[k] - 2 * e.b[k] @ x + x @ e.A[k] @ x)
