"""Estimators: how many metres is a unit, by one frame? Each function is a line in `realsim.scale.metric.ESTIMATORS`."""

import numpy as np

from realsim.core.types import F64, Bool

CONFIDENT = 0.5
"""Quantile of the confidence above which a pixel takes part."""
TOLERANCE = 0.02
"""Relative distance from a ratio within which a pixel agrees with it; twice the noise of a depth sensor at 4 m."""
HYPOTHESES = 64
SCORED = 4000


def median(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
    """Median sensor depth over median predicted depth (TTT-Parkour, "Scale Recovery": lower half of the depth image).

    The lower half shows the terrain at the robot's feet; the upper half shows a background in which sensor and model
    are both at their worst. Pixels valid in both are compared, so both medians are of the same places.

    Args:
        sensor: (M,) metres along z.
        predicted: (M,) units along z, same pixels.
        confidence: (M,) 0..1, unused: the rule has no weights.
        lower: (M,) whether the pixel lies in the lower half.

    Returns:
        Metres per unit, NaN with no pixel in the lower half.
    """
    if not lower.any():
        return float("nan")
    return float(np.median(sensor[lower]) / np.median(predicted[lower]))


def least_squares(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
    """The s that minimises sum w (log sensor - log predicted - log s)^2 over the more confident half of the pixels.

    In the logarithm the error of a pixel is relative, as depth noise and model error are, and the solution is
    symmetric: exchanging sensor and prediction gives 1 / s. A plain fit of sensor = s * predicted is drawn to the far
    background and is biased low by noise in the prediction.

    Args and returns: as `median`.
    """
    keep = confidence >= np.quantile(confidence, CONFIDENT)
    w = confidence[keep]
    if not w.sum() > 0:
        return float("nan")
    return float(np.exp(np.sum(w * np.log(sensor[keep] / predicted[keep])) / w.sum()))


def ransac(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
    """Random sample consensus over single-pixel ratios (Fischler & Bolles 1981), refined by the inliers' median.

    One pixel gives one hypothesis, so 64 draws hit an inlier almost surely even if only one pixel in ten is right.

    Args and returns: as `median`; `rng` draws hypotheses and the pixels that score them.
    """
    logs = np.log(sensor / predicted)
    scored = logs if len(logs) <= SCORED else rng.choice(logs, SCORED, replace=False)
    hypotheses = rng.choice(scored, min(HYPOTHESES, len(scored)), replace=False)
    votes = (np.abs(scored[None, :] - hypotheses[:, None]) < TOLERANCE).sum(1)
    best = hypotheses[int(np.argmax(votes))]
    return float(np.exp(np.median(logs[np.abs(logs - best) < TOLERANCE])))
