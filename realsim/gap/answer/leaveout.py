"""Each fitted run as predicted by a set of causes whose values were fitted without it, and what that says of the set.

What a fit leaves on the runs that it was fitted to tells how wrong the model still is: the size of its discrepancy, by
channel. It takes the place of an assumed one where values get their intervals and where two sets are compared.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.statistics import resampled
from realsim.core.types import F64
from realsim.gap.answer.check import errors, in_blocks, mean_square
from realsim.gap.inference.causes.fit import Fitter
from realsim.gap.inference.causes.fitted import Fit, rests, values_of
from realsim.gap.inference.likelihood.comparison import CORRELATION, Comparison


@dataclass(frozen=True)
class LeftOut:
    """Of the K fitted runs, each left out in turn."""

    residuals: tuple[F64, ...]
    """(B, C) a run, by values fitted to the others; without everyday deviations, as the patch will be used."""
    after: F64
    """(K,) mean square in units of the floor beside the everyday deviations that the other runs make most probable."""
    values: F64
    """(K, m) the values of all causes in a row."""
    sigmas: F64
    """(m,) standard errors under the discrepancy that the fit leaves, or by the jackknife, whichever is larger."""


def leave_out(fitter: Fitter, fit: Fit) -> LeftOut:
    """Refit the values without each run in turn, and predict that run (`Fitter.without_each`).

    Errors count by the noise floor and by what the fit leaves in each channel beside everyday deviations.
    """
    screen, comparison, runs = fitter.screen, fitter.screen.comparison, list(fitter.screen.runs)
    values, residuals, after = [], [], []
    rest = discrepancy(comparison, runs, rests(screen, fit))
    detail = [np.hypot(comparison.noise.detail, rest) for _ in comparison.case.runs]
    fitter = fitter.under(weights=comparison.weights(detail, fitter.conditions.weights.form))
    fit = fitter.spread(fitter.remeasure(fit))
    for k, (x, causes) in enumerate(fitter.without_each(fit)):
        predicted = fitter.of_run(fit, causes, k)
        left = screen.residual(k, predicted, fit.evidence.centre + x - fit.about)
        after.append(mean_square(comparison, [left], [runs[k]]))
        values.append(values_of(causes))
        settings, onsets = [s for c in causes for s in c.settings()], fit.conditions.onsets
        plain = errors(screen.simulator, comparison, settings, [runs[k]], onsets) if fit.about.any() else None
        residuals.append(plain[0] if plain else comparison.residual(runs[k], predicted))
    sigmas = fit.sigmas
    if len(runs) > 2:
        spread = np.array(values) - np.mean(values, axis=0)
        sigmas = np.maximum(sigmas, np.sqrt((len(runs) - 1) / len(runs) * (spread**2).sum(axis=0)))
    return LeftOut(tuple(residuals), np.array(after), np.array(values), sigmas)


def better(
    comparison: Comparison, runs: Sequence[int], ours: Sequence[F64], theirs: Sequence[F64]
) -> tuple[float, float]:
    """(mean, standard error) of what `ours` leaves less than `theirs`, over blocks, in units of its own discrepancy."""
    rest = discrepancy(comparison, runs, ours)
    rows = (
        np.nansum((b**2 - a**2) / (comparison.floor(run) + rest**2), axis=1) / CORRELATION
        for run, a, b in zip(runs, ours, theirs, strict=True)
    )
    values = in_blocks(comparison, rows)
    return float(values.mean()), float(resampled(values, 400, 0).mean(axis=1).std())


def discrepancy(comparison: Comparison, runs: Sequence[int], residuals: Sequence[F64]) -> F64:
    """(C,) root mean square of a residual beyond the floor: what the model still gets wrong, by channel."""
    squares = np.concatenate([r**2 - comparison.floor(run) for run, r in zip(runs, residuals, strict=True)])
    return np.asarray(np.sqrt(np.maximum(np.nanmean(squares, axis=0), 0.0)))
