"""Statistics that several stages share: the bootstrap, and the correlation of two signals.

The bootstrap (Efron 1979) draws whole units: frames, blocks of ground, half seconds of a log.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

Z90 = 1.6449
"""Standard deviations of a Gaussian from its middle to either end of a 90 percent interval."""


def resampled(values: F64, resamples: int, seed: int) -> F64:
    """(resamples, N, ...) of (N, ...) values, each row drawn from them with replacement."""
    picked = np.random.default_rng(seed).integers(0, len(values), (resamples, len(values)))
    return values[picked]


def interval90(samples: F64) -> F64:
    """(2, ...) 5 and 95 percent quantiles of (resamples, ...) values."""
    return np.asarray(np.quantile(samples, [0.05, 0.95], axis=0))


def alike(a: F64, b: F64) -> float:
    """Correlation of two signals (T,) where both are finite; 0 where one does not move or fewer than 20 samples are."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 20:
        return 0.0
    x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-12 * good.sum() else 0.0
