"""Metric scale: pointmaps up to scale, compared with what the depth sensor measured, become metres.

An estimator answers one question for one frame: how many metres is a unit? It is one function and one line in
`ESTIMATORS`. What the frames together say (median, interval, disagreement) is the same for all estimators:
`realsim.scale.metric`.
"""

from realsim.scale.metric import ESTIMATORS, estimate, to_metric

__all__ = ["ESTIMATORS", "estimate", "to_metric"]
