"""Weighted least squares on confident pixels."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64, Bool

CONFIDENT = 0.5
"""Quantile of the confidence above which a pixel takes part."""


def ratio(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
    """The s that minimises sum w (log sensor - log predicted - log s)^2 over the more confident half of the pixels.

    In the logarithm the error of a pixel is relative, as depth noise and model error are, and the solution is
    symmetric: exchanging sensor and prediction gives 1 / s. A plain fit of sensor = s * predicted is drawn to the far
    background and is biased low by noise in the prediction.

    Args and returns: as `realsim.scale.median.ratio`.
    """
    keep = confidence >= np.quantile(confidence, CONFIDENT)
    w = confidence[keep]
    if not w.sum() > 0:
        return float("nan")
    return float(np.exp(np.sum(w * np.log(sensor[keep] / predicted[keep])) / w.sum()))
