"""Which column goes with which joint, by what the signals do in all runs together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from realsim.core.types import F64

BETTER = 0.1
"""Mean agreement (0 to 1.5 a joint) by which another order must be better than the given one to be preferred at all."""
PLAIN = 0.3
"""The same, from which it is preferred to an order that convention gives (columns side by side in one table)."""
ALIKE = 0.05
"""Agreement within which two columns are exchangeable: joints that were moved alike. Set on simulated arms and legs."""
MOST = 3000
"""Samples of a run that are compared, evenly spread over it."""
MAX_LAG = 0.3
"""s by which joints may follow their commands."""


@dataclass(frozen=True)
class Pairing:
    """Columns (A) for joints (B), by their agreement."""

    columns: tuple[int, ...]
    """Of each joint: the best order."""
    gain: float
    """Mean agreement by which each exchanged joint does better than in the given order; 0 where that is the best."""
    margin: float
    """Mean agreement lost by the exchange of two joints that costs least; infinite for one joint."""
    steady: bool
    """Whether at least three quarters of the runs, each alone, prefer the best order to the given one."""


def agreement(times: F64, asked: F64, done: F64) -> F64:
    """(B, A) how well each joint (T, B) follows each command (T, A): correlation, and half for the same level.

    At one lag for all, since a pair of its own lag may take one sine for another.
    """
    good = np.flatnonzero(np.isfinite(asked).all(axis=1) & np.isfinite(done).all(axis=1))
    if len(good) < 30:
        return np.zeros((done.shape[1], asked.shape[1]))
    rows = good[:: max(1, len(good) // MOST)]
    t, a, b = times[rows], asked[rows], done[rows]
    step = max(float(np.median(np.diff(t))), 1e-3)
    lags = np.unique(np.linspace(0, min(int(MAX_LAG / step), len(t) // 4), 16).astype(int))
    tables = [_correlation(a[: len(a) - k], b[k:]) for k in lags]
    best = max(tables, key=lambda c: float(c[linear_sum_assignment(-c)].sum()))
    apart = np.abs(b.mean(axis=0)[:, None] - a.mean(axis=0)[None, :]) / (np.std(b, axis=0)[:, None] + 1e-9)
    return np.asarray(best + 0.5 * np.exp(-apart) * (best != 0))


def _correlation(a: F64, b: F64) -> F64:
    """(B, A) of columns (T, A), (T, B); 0 for a column that does not move."""
    x, y = a - a.mean(axis=0), b - b.mean(axis=0)
    size = np.outer(np.sqrt((y**2).sum(axis=0)), np.sqrt((x**2).sum(axis=0)))
    return np.asarray(np.abs(np.where(size > 1e-9 * len(a), (y.T @ x) / np.maximum(size, 1e-12), 0.0)))


def pair(tables: Sequence[F64], given: Sequence[int]) -> Pairing:
    """The order of columns that suits all runs' tables (B, A) of agreement best, beside the given one."""
    mean = np.mean(tables, axis=0)
    joints = np.arange(len(given))
    held = list(given)
    best = np.empty(len(given), dtype=int)
    rows, columns = linear_sum_assignment(-mean)
    best[rows] = columns
    moved = [b for b in joints if best[b] != held[b]]
    gain = float(np.mean([mean[b, best[b]] - mean[b, held[b]] for b in moved])) if moved else 0.0
    agree = [sum(t[b, best[b]] - t[b, held[b]] for b in moved) > 0 for t in tables if t.any()]
    return Pairing(tuple(int(c) for c in best), gain, _margin(mean, best), bool(np.mean(agree or [0]) >= 0.75))


def _margin(table: F64, chosen: F64) -> float:
    own = table[np.arange(len(chosen)), chosen]
    crossed = table[:, chosen]
    loss = 0.5 * (own[:, None] + own[None, :] - crossed - crossed.T)
    loss[np.diag_indices(len(chosen))] = np.inf
    loss[own <= 0] = np.inf  # a joint that rests tells nothing, and nothing depends on it
    return float(loss.min()) if len(chosen) > 1 else np.inf
