"""Whether an error is above the floor beyond what blocks of half a second scatter, with the share of false names held
down (Benjamini and Hochberg, 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.core.statistics import resampled
from realsim.core.types import F64
from realsim.gap.inference.likelihood.comparison import Comparison

BLOCK_SECONDS = 0.5
FEWEST_BLOCKS = 12
"""Short logs are cut into shorter blocks, so that there are at least as many."""
FALSE_SHARE = 0.1
"""Expected share of false names among those that are named."""
RESAMPLES = 400


def excesses(comparison: Comparison, residuals: Sequence[F64]) -> list[F64]:
    """(B, C) a run: squared error in units of the floor, less one; its mean is zero where there is no gap."""
    return [np.nan_to_num(r**2 / comparison.floor(i) - 1) for i, r in enumerate(residuals)]


def significant(p: Sequence[float], false_share: float = FALSE_SHARE) -> list[bool]:
    """Which of many tests to believe so that at most this share of them is expected to be false."""
    if not len(p):
        return []
    from scipy.stats import false_discovery_control  # Benjamini and Hochberg 1995

    return [bool(adjusted <= false_share) for adjusted in false_discovery_control(np.asarray(p, float))]


def tail(
    comparison: Comparison, values: Sequence[F64], masks: Sequence[Any], against: float, seed: int = 0
) -> tuple[float, float]:
    """(p, mean): one-sided chance that a mean over masked samples exceeds `against` only by scatter between blocks.

    Args:
        values, masks: (B,) a run. The standard error is that of a bootstrap over blocks of half a second.
    """
    bins = sum(len(v) for v in values)
    width = max(min(int(BLOCK_SECONDS / comparison.config.bin_seconds), bins // FEWEST_BLOCKS), 1)
    sums, counts = [], []
    for v, m in zip(values, masks, strict=True):
        edges = np.arange(0, len(v), width)
        sums.append(np.add.reduceat(np.where(m, v, 0.0), edges))
        counts.append(np.add.reduceat(np.asarray(m, float), edges))
    s, n = np.concatenate(sums), np.concatenate(counts)
    filled = np.flatnonzero(n)
    if len(filled) < 4:
        return 1.0, float(s.sum() / max(n.sum(), 1))
    s, n = s[filled], n[filled]
    drawn = resampled(np.stack([s, n], axis=1), RESAMPLES, seed).sum(axis=1)
    means = drawn[:, 0] / drawn[:, 1]
    mean = float(s.sum() / n.sum())
    from scipy.special import ndtr

    return float(ndtr(-(mean - against) / max(float(means.std()), 1e-12))), mean
