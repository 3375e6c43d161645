"""A correction learned without a cause: ridge regression of the residual on what the simulator does.

It is the baseline that a named cause must bear comparison with, and a detector: if it still predicts on unseen runs
what the diagnosis has left, there is structure that no effect of the library names.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from realsim.core.types import F64
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

LAGS = (0, 1, 3, 6, 12)
"""Bins back."""
RIDGES = (1e-2, 1.0, 1e2)


def predict(
    simulator: Simulator, comparison: Comparison, residuals: Sequence[F64], fitted: Sequence[int], runs: Sequence[int]
) -> list[F64]:
    """(B, C) predicted residual of `runs`, learned from `residuals` (one a fitted run). NaN counts as no sample."""
    result = [np.zeros_like(comparison.weights[r]) for r in runs]
    for c in range(len(comparison.channels)):
        train = [_features(simulator, comparison, r, c) for r in fitted]
        center, scale = np.mean(np.concatenate(train), axis=0), np.std(np.concatenate(train), axis=0) + 1e-9
        X = [np.column_stack([(f - center) / scale, np.ones(len(f))]) for f in train]
        y = [np.nan_to_num(r[:, c]) for r in residuals]
        weights = _ridge(X, y)
        for k, run in enumerate(runs):
            F = (_features(simulator, comparison, run, c) - center) / scale
            result[k][:, c] = np.clip(np.column_stack([F, np.ones(len(F))]) @ weights, *_range(y))
    return result


def _range(y: Sequence[F64]) -> tuple[float, float]:
    every = np.concatenate(y)
    return 1.5 * float(min(every.min(), 0.0)), 1.5 * float(max(every.max(), 0.0))


def _ridge(X: Sequence[F64], y: Sequence[F64]) -> F64:
    """Weights with the ridge that predicts runs left out best."""
    best: tuple[float, float] = (np.inf, RIDGES[-1])
    if len(X) > 1:
        for ridge in RIDGES:
            error = 0.0
            for k in range(len(X)):
                others = [i for i in range(len(X)) if i != k]
                w = _solve([X[i] for i in others], [y[i] for i in others], ridge)
                error += float(((y[k] - X[k] @ w) ** 2).sum())
            best = min(best, (error, ridge))
    return _solve(X, y, best[1])


def _solve(X: Sequence[F64], y: Sequence[F64], ridge: float) -> F64:
    A, b = np.concatenate(X), np.concatenate(y)
    return np.asarray(np.linalg.solve(A.T @ A + ridge * len(A) * 1e-2 * np.eye(A.shape[1]), A.T @ b), dtype=float)


def _features(simulator: Simulator, comparison: Comparison, run: int, channel: int) -> F64:
    """(B, K) of the nominal simulation, of the channel's own joint (or of all joints' means), at several lags."""
    track = simulator.nominal_tracks[run]
    settle, dt = (float(v) for v in track["settle"])
    names = simulator.case.joint_names
    label = comparison.channels[channel].label
    j = [names.index(label)] if label in names else list(range(len(names)))
    columns = []
    for lag in LAGS:
        time = comparison.times[run] - lag * comparison.config.bin_seconds
        at = np.clip(((time + settle) / dt).astype(int), 0, len(track["pos"]) - 1)
        q, v, tau = (np.nan_to_num(track[k][at][:, j]) for k in ("pos", "vel", "torque"))
        slow = 0.05 * np.abs(track["vel"][:, j]).max(axis=0) + 1e-9
        way = np.tanh(v / slow)
        parts = [q, v, tau, way, np.abs(tau) * way, np.abs(q) * q]
        columns += [p if len(j) == 1 else p[:, :: max(len(j) // 8, 1)] for p in parts]
    return np.nan_to_num(np.concatenate(columns, axis=1))
