"""Which column is which, by what signals do: joints follow their commands, and velocities are slopes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.units import travelled
from realsim.gap.recordings.signals import MAX_LAG, follows

BETTER = 0.1
"""Mean agreement (0 to 1.5 a joint) by which another order must be better than the given one to be preferred at all."""
PLAIN = 0.3
"""The same, from which it is preferred to an order that convention gives (columns side by side in one table)."""
ALIKE = 0.05
"""Agreement within which two columns are exchangeable: joints that were moved alike. Set on simulated arms and legs."""
MOST = 3000
"""Samples of a run that are compared, evenly spread over it."""


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


def agreement(times: F64, commanded: F64, done: F64) -> F64:
    """(B, A) how well each joint (T, B) follows each command (T, A): correlation, and half for the same level.

    At one lag for all, since a pair of its own lag may take one sine for another.
    """
    from scipy.optimize import linear_sum_assignment

    good = np.flatnonzero(np.isfinite(commanded).all(axis=1) & np.isfinite(done).all(axis=1))
    if len(good) < 30:
        return np.zeros((done.shape[1], commanded.shape[1]))
    rows = good[:: max(1, len(good) // MOST)]
    t, a, b = times[rows], commanded[rows], done[rows]
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
    from scipy.optimize import linear_sum_assignment

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


SLOPE = 0.95
"""Correlation of what is travelled with an integral, from which one block of columns is the other's velocity. Set by
hand on made logs, not measured on others."""
LEADS = 0.95
"""Correlation with which joints follow a block of columns that is their command."""
MOST_SAMPLES = 4000
MOST_COLUMNS = 64


def leads(time: F64, commanded: F64, done: F64) -> float:
    """How well joints (T, K) follow columns (T, K) some time later: the median correlation, 0 where it is not later."""
    found = []
    for k in range(done.shape[1]):
        if np.nanstd(commanded[:, k]) < 1e-6 or np.nanstd(done[:, k]) < 1e-6:
            continue
        corr, lag, _, _ = follows(time[:MOST_SAMPLES], commanded[:MOST_SAMPLES, k], done[:MOST_SAMPLES, k])
        found.append(corr if lag > 0 else 0.0)
    return float(np.median(found)) if found else 0.0


def blocks(time: F64, table: F64, width: int) -> dict[str, int]:
    """Role -> the first of `width` columns side by side of a table (T, C): joint_pos, joint_vel, command.

    Empty where no block is the slope of another, or follows one: then nothing tells positions from all else.
    """
    time, table = time[:MOST_SAMPLES], table[:MOST_SAMPLES, :MOST_COLUMNS]
    starts = range(table.shape[1] - width + 1)
    parts = {k: table[:, k : k + width] for k in starts if np.nanmax(np.nanstd(table[:, k : k + width], axis=0)) > 1e-6}
    apart = [(a, b) for a in parts for b in parts if abs(a - b) >= width]
    slopes = {(p, v): _slope(time, parts[p], parts[v]) for p, v in apart}
    good = [pair for pair, corr in slopes.items() if corr > SLOPE]
    found: dict[str, int] = {}
    speeds = {v for _, v in good}
    good = [pair for pair in good if pair[0] not in speeds] or good  # accelerations are the slope of velocities, too
    if good:
        place, speed = max(good, key=lambda pair: slopes[pair])
        found = {"joint_pos": place, "joint_vel": speed}
    moving = {k for k, v in parts.items() if 2 * (np.nanstd(v, axis=0) > 1e-6).sum() >= width}  # one joint tells little
    apart = [(c, p) for c, p in apart if c in moving and p == found.get("joint_pos", p)]
    leading = {(c, p): leads(time, parts[c], parts[p]) for c, p in apart}
    leading = {pair: corr for pair, corr in leading.items() if pair[0] != found.get("joint_vel") and corr > LEADS}
    if leading:
        command, place = max(leading, key=lambda pair: leading[pair])
        found |= {"joint_pos": place, "command": command}
    return found


def _slope(time: F64, place: F64, speed: F64) -> float:
    """Correlation of ways travelled with integrals, of all columns together: those that rest hardly count."""
    pairs = [travelled(time, place[:, k], speed[:, k]) for k in range(place.shape[1])]
    ways = [(moved - np.nanmean(moved), sums - np.nanmean(sums)) for moved, sums in pairs if len(moved)]
    if not ways:
        return 0.0
    moved, sums = (np.concatenate(side) for side in zip(*ways, strict=True))
    return alike(sums, moved) if np.nanstd(moved) > 1e-9 else 0.0
