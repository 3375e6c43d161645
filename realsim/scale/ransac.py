"""The ratio that most pixels agree on."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64, Bool

TOLERANCE = 0.02
"""Relative distance from a ratio within which a pixel agrees with it; twice the noise of a depth sensor at 4 m."""
HYPOTHESES = 64
SCORED = 4000


def ratio(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
    """Random sample consensus over single-pixel ratios (Fischler & Bolles 1981), refined by the inliers' median.

    One pixel gives one hypothesis, so 64 draws hit an inlier almost surely even if only one pixel in ten is right.

    Args and returns: as `realsim.scale.median.ratio`; `rng` draws hypotheses and the pixels that score them.
    """
    logs = np.log(sensor / predicted)
    scored = logs if len(logs) <= SCORED else rng.choice(logs, SCORED, replace=False)
    hypotheses = rng.choice(scored, min(HYPOTHESES, len(scored)), replace=False)
    votes = (np.abs(scored[None, :] - hypotheses[:, None]) < TOLERANCE).sum(1)
    best = hypotheses[int(np.argmax(votes))]
    return float(np.exp(np.median(logs[np.abs(logs - best) < TOLERANCE])))
