"""The paper's rule: a ratio of medians over the lower half of the image."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64, Bool


def ratio(sensor: F64, predicted: F64, confidence: F64, lower: Bool, rng: np.random.Generator) -> float:
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
