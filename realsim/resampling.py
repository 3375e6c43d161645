"""The bootstrap (Efron 1979), of whatever is drawn as a whole: frames, blocks of ground, half seconds of a log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def resampled(values: F64, resamples: int, seed: int) -> F64:
    """(resamples, N, ...) of (N, ...) values, each row drawn from them with replacement."""
    picked = np.random.default_rng(seed).integers(0, len(values), (resamples, len(values)))
    return values[picked]


def interval90(samples: F64) -> F64:
    """(2, ...) 5 and 95 percent quantiles of (resamples, ...) values."""
    return np.asarray(np.quantile(samples, [0.05, 0.95], axis=0))
