"""Metric scale: pointmaps up to scale, compared with what the depth sensor measured, become metres.

An estimator answers one question for one frame: how many metres is a unit? It is one small file and one line here.
What the frames together say (median, interval, disagreement) is the same for all estimators: `realsim.scale.metric`.
"""

from __future__ import annotations

from realsim.registry import Registry
from realsim.scale.metric import estimate, to_metric

ESTIMATORS = Registry(
    "scale estimator",
    {
        "median": "realsim.scale.median:ratio",
        "least_squares": "realsim.scale.least_squares:ratio",
        "ransac": "realsim.scale.ransac:ratio",
    },
)
"""name -> f(sensor (M,), predicted (M,), confidence (M,), lower (M,) bool, rng) -> metres per unit, NaN if unknown."""

__all__ = ["ESTIMATORS", "estimate", "to_metric"]
