"""The similarity between two sets of corresponding points, whatever some of them say."""

from dataclasses import dataclass

import numpy as np

from realsim.core.geometry import make_T, nearest_rotation
from realsim.core.types import F64

ITERATIONS = 15
TUKEY = 4.685
"""Residual in standard deviations from which a point has no weight."""
AGREES = 0.05
"""Relative to its distance, how far off a point may be that still agrees."""
MAX_POINTS = 6000


@dataclass(frozen=True)
class Similarity:
    """target = scale * R source + t, and how well it holds."""

    T: F64
    """(4, 4), scale included."""
    scale: float
    inliers: float
    """Share of the points that agree."""
    error: float
    """Median relative residual."""

    @property
    def rigid(self) -> F64:
        """(4, 4) rotation and translation alone."""
        out = self.T.copy()
        out[:3, :3] /= self.scale
        return out


def umeyama(source: F64, target: F64, weight: F64) -> tuple[F64, float]:
    """Weighted least-squares similarity ((4, 4), scale) of points (M, 3) (Umeyama 1991)."""
    w = weight / weight.sum()
    a, b = w @ source, w @ target
    x, y = source - a, target - b
    M = (y * w[:, None]).T @ x
    R = nearest_rotation(M)
    scale = float((R * M).sum() / max((w[:, None] * x * x).sum(), 1e-300))
    return make_T(scale * R, b - scale * R @ a), scale


def robust_similarity(source: F64, target: F64, distance: F64, weight: F64 | None = None) -> Similarity | None:
    """Iterated weights (Tukey) on residuals relative to `distance` (M,), as errors of predicted depth are.

    None with fewer than ten points, or points in one place.
    """
    usable = np.isfinite(source).all(1) & np.isfinite(target).all(1) & (distance > 0)
    pick = np.flatnonzero(usable)
    if len(pick) < 10:
        return None
    pick = pick[np.unique(np.linspace(0, len(pick) - 1, MAX_POINTS).astype(int))]
    p, q, z = source[pick], target[pick], distance[pick]
    base = (np.ones(len(p)) if weight is None else weight[pick]) / z**2
    if not base.sum() > 0 or np.ptp(p, 0).max() <= 0:
        return None
    w = base
    for _ in range(ITERATIONS):
        T, scale = umeyama(p, q, w)
        r = np.linalg.norm(p @ T[:3, :3].T + T[:3, 3] - q, axis=1) / z
        sigma = max(1.4826 * float(np.median(r)), 1e-6)
        w = base * (1 - np.minimum(r / (TUKEY * sigma), 1) ** 2) ** 2
    if not (np.isfinite(T).all() and scale > 0):
        return None
    return Similarity(T, scale, float((r < AGREES).mean()), float(np.median(r)))
