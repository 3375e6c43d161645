"""Each fitted run as predicted by a set of causes whose values were fitted without it, and what that says of the set.

What a fit leaves on the runs that it was fitted to tells how wrong the model still is: the size of its discrepancy, by
channel. It takes the place of an assumed one where values get their intervals and where two sets are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.errors import GapError
from realsim.gap.answer.check import BLOCK_SECONDS, errors, mean_square
from realsim.gap.causes.fitted import Z90, causes_of
from realsim.gap.causes.leftover import reasonable
from realsim.gap.compare import CORRELATION, Comparison
from realsim.gap.effects.base import Parameter
from realsim.gap.simulation.simulate import Setting, lookup
from realsim.types import F64

FARTHEST = 2.0
"""Steps of a parameter that leaving out one run may move a value at most: beyond, its slope says nothing. Not tuned."""
WIDE = 10.0
"""Steps of a parameter: prior scale of values that these runs hardly determine. Not tuned."""


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

    def gained_over(self, other: LeftOut) -> tuple[float, float]:
        """(mean, standard error) over runs of the logarithm of the ratio of errors: one run that diverges counts once.

        Both beside everyday deviations: without them, what they do to the motion may be far more than a cause's share.
        """
        ratios = np.log(np.maximum(other.after, 1e-9) / np.maximum(self.after, 1e-9))
        error = float(ratios.std(ddof=1) / np.sqrt(len(ratios))) if len(ratios) > 1 else 0.0
        return float(ratios.mean()), error


def leave_out(screen: Any, fitter: Any, fit: Any) -> LeftOut:
    """Refit the values without each run in turn, and predict that run.

    A Gauss-Newton step from the fitted values: slopes by simulation, everyday deviations (linear, with their priors)
    fitted beside them. Errors count by the noise floor and by what the fit leaves in each channel.
    """
    comparison: Comparison = screen.comparison
    runs, simulator = list(screen.runs), screen.simulator
    candidates = [c.candidate for c in fit.causes]
    z = np.array([v for c in fit.causes for v in c.values])
    parameters = _parameters(screen, candidates)
    prior = fitter.prior_beside(candidates)
    deviations = screen.settings(fit.about)
    base = errors(simulator, comparison, [*fit.settings(), *deviations], runs)
    if base is None:
        raise GapError("the simulator fails with the values found", hint="look at the units of the log")
    slopes = _slopes(screen, candidates, parameters, z, base, deviations)
    active = np.flatnonzero(prior > 0)
    steps = np.array([abs(p.step) for p in parameters])
    # Deviations count from what is most usual, those in the simulation included.
    shift = fit.about - fit.evidence.centre
    normal = _Normal(screen, [r + screen.fitted(k, shift) for k, r in enumerate(base)], slopes, active, prior, steps)
    every = normal.solve(range(len(runs)))[: len(z)]
    few = len(runs) < 2
    values, residuals, after = [], [], []
    for k, run in enumerate(runs):
        x = normal.solve([i for i in range(len(runs)) if i != k or few])
        moved = z + _bounded(x[: len(z)] - every, z, parameters)
        settings = [s for c in causes_of(candidates, moved) for s in c.settings()]
        found = errors(simulator, comparison, [*settings, *deviations], [run])
        plain = errors(simulator, comparison, settings, [run]) if deviations else found
        values.append(moved if found is not None else z)
        residuals.append(plain[0] if plain is not None else base[k])
        y = np.zeros(len(prior))
        y[active] = reasonable(x[len(z) :], prior[active])
        rest = (found[0] if found is not None else base[k]) + screen.fitted(k, shift - y)
        after.append(mean_square(comparison, [rest], [run]))
    sigmas = np.sqrt(np.maximum(np.diag(normal.covariance()), 0.0))
    if len(runs) > 2:
        spread = np.array(values) - np.mean(values, axis=0)
        sigmas = np.maximum(sigmas, np.sqrt((len(runs) - 1) / len(runs) * (spread**2).sum(axis=0)))
    return LeftOut(tuple(residuals), np.array(after), np.array(values), sigmas)


def better(
    comparison: Comparison, runs: Sequence[int], ours: Sequence[F64], theirs: Sequence[F64], seed: int = 0
) -> tuple[float, float]:
    """(mean, standard error) of what `ours` leaves less than `theirs`, over blocks, in units of its own discrepancy."""
    rest = discrepancy(comparison, runs, ours)
    width = max(int(BLOCK_SECONDS / comparison.config.bin_seconds), 1)
    sums = []
    for run, a, b in zip(runs, ours, theirs, strict=True):
        row = np.nansum((b**2 - a**2) / (comparison.floor(run) + rest**2), axis=1) / CORRELATION
        sums.append(np.add.reduceat(row, np.arange(0, len(row), width)))
    values = np.concatenate(sums)
    pick = np.random.default_rng(seed).integers(0, len(values), (400, len(values)))
    return float(values.mean()), float(values[pick].mean(axis=1).std())


def discrepancy(comparison: Comparison, runs: Sequence[int], residuals: Sequence[F64]) -> F64:
    """(C,) root mean square of a residual beyond the floor: what the model still gets wrong, by channel."""
    squares = np.concatenate([r**2 - comparison.floor(run) for run, r in zip(runs, residuals, strict=True)])
    return np.sqrt(np.maximum(np.nanmean(squares, axis=0), 0.0))


def clear(fit: Any, screen: Any, found: LeftOut) -> list[bool]:
    """Whether the 90 percent interval of some strength of each cause excludes nothing, under the discrepancy."""
    result, i = [], 0
    for cause in fit.causes:
        n = len(cause.values)
        rows = zip(cause.values, found.sigmas[i : i + n], _parameters(screen, [cause.candidate]), strict=True)
        result.append(any(p.strength and abs(v) > Z90 * s for v, s, p in rows))
        i += n
    return result


class _Normal:
    """Normal equations of values and everyday deviations, a matrix a run; the rest after them sets the weights."""

    def __init__(
        self, screen: Any, base: Sequence[F64], slopes: Sequence[F64], active: Any, prior: F64, steps: F64
    ) -> None:
        self.count = len(steps)
        self._penalty = np.concatenate([1 / (WIDE * steps) ** 2, 1 / prior[active] ** 2])
        comparison, runs = screen.comparison, list(screen.runs)
        columns = [np.hstack([J, screen.columns(k, active)]) for k, J in enumerate(slopes)]
        rest = discrepancy(comparison, runs, base)
        for _ in range(2):
            self._A, self._b = [], []
            for run, r, X in zip(runs, base, columns, strict=True):
                detail = np.hypot(comparison.noise.detail, rest)
                weight = 1 / (comparison.variance(run) + CORRELATION * detail**2)
                weight = np.where(np.isfinite(r), weight, 0.0).reshape(-1, 1)
                self._A.append((X.T @ (weight * X)).astype(float))
                self._b.append(np.asarray(X.T @ (weight[:, 0] * np.nan_to_num(r).reshape(-1)), float))
            x = self.solve(range(len(runs)))
            left = [r - (X @ x).reshape(r.shape) for r, X in zip(base, columns, strict=True)]
            rest = discrepancy(comparison, runs, left)

    def covariance(self) -> F64:
        """(m, m) of the values, deviations integrated out."""
        A = np.sum(self._A, axis=0) + np.diag(self._penalty)
        return np.asarray(np.linalg.pinv(A, hermitian=True))[: self.count, : self.count]

    def solve(self, which: Sequence[int] | range) -> F64:
        """(m + active,) change of the values that these runs ask for, and the deviations beside it."""
        A = np.sum([self._A[k] for k in which], axis=0) + np.diag(self._penalty)
        return np.asarray(np.linalg.lstsq(A, np.sum([self._b[k] for k in which], axis=0), rcond=None)[0])


def _slopes(
    screen: Any,
    candidates: Sequence[Any],
    parameters: Sequence[Parameter],
    z: F64,
    base: Sequence[F64],
    beside: Sequence[Setting],
) -> list[F64]:
    """(B * C, m) a run: change of the prediction by each value; nothing where neither side can be simulated."""
    runs, found = list(screen.runs), [np.zeros((r.size, len(z))) for r in base]
    for i, p in enumerate(parameters):
        for width in (0.1 * p.step, -0.1 * p.step):
            moved = z.copy()
            moved[i] += width
            if not p.bounds[0] <= moved[i] <= p.bounds[1]:
                continue
            settings: list[Setting] = [s for c in causes_of(candidates, moved) for s in c.settings()]
            there = errors(screen.simulator, screen.comparison, [*settings, *beside], runs)
            if there is not None:
                for k, (a, b) in enumerate(zip(base, there, strict=True)):
                    found[k][:, i] = np.nan_to_num((a - b) / width).reshape(-1)
                break
    return found


def _bounded(step: F64, z: F64, parameters: Sequence[Parameter]) -> F64:
    far = FARTHEST * np.array([abs(p.step) for p in parameters])
    low, high = np.array([p.bounds for p in parameters]).reshape(-1, 2).T
    return np.asarray(np.clip(z + np.clip(step, -far, far), low, high) - z)


def _parameters(screen: Any, candidates: Sequence[Any]) -> list[Parameter]:
    """Of all values in a row."""
    found = []
    for c in candidates:
        every = {p.name: p for p in lookup(c.effect).parameters(screen.simulator.context, c.place)}
        found += [every[n] for n in c.names]
    return found
