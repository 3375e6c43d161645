"""How likely a residual is when neither the noise nor the model's error is known in advance.

Residuals of every channel go into the frequency domain (orthonormal DCT-II), where a stationary error has independent
coefficients (Whittle's likelihood). In every channel and octave their variance is estimated with each set of causes
(profile likelihood), and is never less than the floor: the sensors' noise and a small coloured model error. Large
errors thus weigh by their logarithm, and none is assumed to be small. Everyday deviations are linear, r = G x + e, and
integrated out by Laplace's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.selection.figures import BAND_EDGES_HZ, DISCREPANCY_SECONDS, IRLS_ROUNDS
from realsim.types import F64

BANDS = len(BAND_EDGES_HZ) + 1


@dataclass(frozen=True)
class Moments:
    """What the likelihood needs to know of a residual: cell by cell (a channel in a band), all runs together."""

    b: F64
    """(cells, p) products with the columns."""
    c: F64
    """(cells,) squares."""


@dataclass(frozen=True)
class Marginal:
    """A residual's log-likelihood once the deviations are integrated out."""

    value: float
    """Nats, up to a constant of the data."""
    x: F64
    """(p,) the most probable deviations."""
    weights: F64
    """(cells,) inverse variances."""
    information: F64
    """(p, p) of the columns under these weights."""
    covariance: F64
    """(p, p) of the deviations."""


class Likelihood:
    """Profile likelihood over channels and octaves, for the runs at these positions of a screen."""

    def __init__(self, screen: Screen, comparison: Comparison, positions: Sequence[int] | None = None) -> None:
        self.screen, self.comparison = screen, comparison
        self.positions = tuple(range(len(screen.runs)) if positions is None else positions)
        self._channels = len(comparison.channels)
        self._bands = {k: self._band_of(screen.runs[k]) for k in self.positions}
        self.columns = {k: self._transformed_columns(k) for k in self.positions}
        """Position -> (B * C, p) float32."""
        cells = self._channels * BANDS
        self.counts = np.sum([np.bincount(self._cell(k), minlength=cells) for k in self.positions], axis=0).astype(
            float
        )
        self.floor = self._floor()
        p = len(screen.atoms)
        self._gram = np.zeros((cells, p, p), np.float32)
        for k in self.positions:
            cell, G = self._cell(k), self.columns[k]
            for i in np.unique(cell):
                rows = G[cell == i]
                self._gram[i] += rows.T @ rows

    # ------------------------------------------------------------ residuals

    def transform(self, k: int, residual: F64) -> F64:
        """(B * C,) coefficients of a (B, C) residual of the run at position k; bins without a sample are zero."""
        return np.asarray(dct(np.nan_to_num(residual), axis=0, norm="ortho")).reshape(-1)

    def residual(self, predictions: Sequence[F64], about: F64 | None = None) -> list[F64]:
        """Coefficients a run; deviations `about` (p,) that are in the predictions are taken out again."""
        found = []
        for k, y in zip(self.positions, predictions, strict=True):
            r = self.transform(k, self.comparison.residual(self.screen.runs[k], y))
            found.append(r if about is None or not about.any() else r + self.columns[k] @ about.astype(np.float32))
        return found

    def moments(self, residual: Sequence[F64]) -> Moments:
        b, c = np.zeros((len(self.counts), len(self.screen.atoms))), np.zeros(len(self.counts))
        for k, r in zip(self.positions, residual, strict=True):
            cell, G = self._cell(k), self.columns[k]
            c += np.bincount(cell, r * r, len(c))
            order, starts = self._order(k)
            products = np.add.reduceat((G * r[:, None].astype(np.float32))[order], starts, axis=0)
            b[cell[order][starts]] += products
        return Moments(b, c)

    def row_weights(self, k: int, weights: F64) -> F64:
        """(B * C,) weight of every coefficient."""
        return np.asarray(weights[self._cell(k)])

    # ------------------------------------------------------------ the score

    def marginal(self, m: Moments, factor: F64, start: F64 | None = None, rounds: int = IRLS_ROUNDS) -> Marginal:
        """Laplace's approximation for x = factor u, u standard normal.

        Args:
            factor: (p,) standard deviations, or (p, q) a square root of the prior's covariance.
            start: (cells,) weights to begin with.
        """
        F = np.diag(factor)[:, factor > 0] if factor.ndim == 1 else factor
        n, x = self.counts, np.zeros(F.shape[0])
        w = 1.0 / np.maximum(self.floor, m.c / np.maximum(n, 1.0)) if start is None else start
        value, best = -np.inf, None
        for _ in range(rounds):
            A = self.information(w)
            inner = np.eye(F.shape[1]) + F.T @ A @ F
            u = np.linalg.solve(inner, F.T @ (w @ m.b))
            x = F @ u
            square = np.maximum(m.c - 2 * m.b @ x + np.einsum("cij,i,j->c", self._gram, x, x, optimize=True), 0.0)
            variance = np.maximum(self.floor, square / np.maximum(n, 1.0))
            new = -0.5 * float(n @ np.log(variance / self.floor) + np.sum(square / variance)) - 0.5 * float(u @ u)
            w = 1.0 / variance
            if best is not None and new < value + 1e-2:
                break
            value, best = max(new, value), (x, A, inner)
        assert best is not None
        x, A, inner = best
        _, logdet = np.linalg.slogdet(inner)
        cov = F @ np.linalg.solve(inner, F.T)
        return Marginal(value - 0.5 * float(logdet), x, w, A, cov)

    def information(self, weights: F64) -> F64:
        """(p, p) of the columns under (cells,) weights."""
        return np.asarray(np.tensordot(weights.astype(np.float32), self._gram, 1), np.float64)

    # ------------------------------------------------------------ inside

    def _floor(self) -> F64:
        """(cells,) variance of a coefficient before the data: noise, and model error with a first-order spectrum."""
        width = self.comparison.config.bin_seconds
        noise, extra = np.zeros(len(self.counts)), np.zeros(len(self.counts))
        for k in self.positions:
            run, cell = self.screen.runs[k], self._cell(k)
            variance = np.nanmean(self.comparison.variance(run), axis=0)
            f = self._frequencies(run)
            low = 2 * DISCREPANCY_SECONDS / width / (1 + (2 * np.pi * f * DISCREPANCY_SECONDS) ** 2)
            detail = self.comparison.noise.detail**2
            noise += np.bincount(cell, np.tile(variance, len(f)), len(noise))
            extra += np.bincount(cell, (low[:, None] * detail).reshape(-1), len(noise))
        return np.asarray((noise + extra) / np.maximum(self.counts, 1.0)) + 1e-30

    def _frequencies(self, run: int) -> F64:
        bins = len(self.comparison.times[run])
        return np.arange(bins) / (2 * bins * self.comparison.config.bin_seconds)

    def _band_of(self, run: int) -> np.ndarray:
        return np.searchsorted(BAND_EDGES_HZ, self._frequencies(run), side="right")

    def _cell(self, k: int) -> np.ndarray:
        """(B * C,) the cell of every coefficient."""
        return (np.arange(self._channels)[None, :] * BANDS + self._bands[k][:, None]).reshape(-1)

    def _order(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        cell = self._cell(k)
        order = np.argsort(cell, kind="stable")
        return order, np.flatnonzero(np.diff(cell[order], prepend=-1))

    def _transformed_columns(self, k: int) -> np.ndarray:
        shape = self.comparison.weights[self.screen.runs[k]].shape
        G = self.screen.columns(k, range(len(self.screen.atoms))).reshape(*shape, -1)
        return np.asarray(dct(G, axis=0, norm="ortho"), np.float32).reshape(shape[0] * shape[1], -1)
