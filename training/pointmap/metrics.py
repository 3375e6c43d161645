"""Figures of a prediction against the truth. Arrays are NumPy's; depth is along z, metres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
SHARES = np.linspace(0, 0.95, 20)
"""Of the pixels that are taken away, the least sure first."""


@dataclass(frozen=True)
class Figures:
    """Of a set of views in one scale."""

    abs_rel: float
    """Mean of |z - z'| / z' after one median scale for all views."""
    abs_rel_view: float
    """The same with a scale of its own for every view."""
    flat: float
    """`abs_rel` of one depth for every pixel: what the figures above are worth."""
    rotation_deg: float
    """Median over pairs of views of the angle between true and predicted relative rotation; nan without true poses."""
    still_deg: float
    """The same of a prediction that no camera has turned."""
    direction_deg: float
    """Median angle between true and predicted relative translations, of pairs that moved by more than 2 cm."""
    area: float
    """Under the sparsification curve: mean error of what is left over the error of all, mean over SHARES."""
    area_oracle: float
    """The same if the pixels were taken away by their true error: nothing can be lower."""
    confidence: float
    """Mean, 0..1."""

    @property
    def ause(self) -> float:
        """Area between the two curves (Ilg et al. 2018); a random confidence has 1 - area_oracle."""
        return self.area - self.area_oracle


def figures(depth: NDArray, conf: NDArray, T: F64, true_depth: NDArray, true_T: F64) -> Figures:
    """Compare V views.

    Args:
        depth, conf: (V, H, W) predicted.
        T: (V, 4, 4) predicted camera to world.
        true_depth: (V, H, W), 0 where it is unknown.
        true_T: (V, 4, 4).
    """
    valid = (true_depth > 0) & np.isfinite(depth) & (depth > 0)
    ratio = true_depth[valid] / depth[valid]
    if not len(ratio):
        return Figures(*[float("nan")] * 9)
    error = np.abs(np.where(valid, depth, 0) * np.median(ratio) - true_depth) / np.maximum(true_depth, 1e-6)
    own = [
        np.abs(depth[k][m] * np.median(true_depth[k][m] / depth[k][m]) / true_depth[k][m] - 1)
        for k, m in enumerate(valid)
        if m.any()
    ]
    flat = np.abs(np.median(true_depth[valid]) / true_depth[valid] - 1)
    turned, still, aside = pose_errors(T, true_T)
    area, oracle = sparsification(error[valid], conf[valid])
    return Figures(
        float(error[valid].mean()), float(np.concatenate(own).mean()), float(flat.mean()), turned, still, aside, area,
        oracle, float(conf.mean()),
    )  # fmt: skip


def pose_errors(T: F64, true_T: F64) -> tuple[float, float, float]:
    """Medians over pairs, degrees: rotation, rotation of the truth itself, direction of translation."""
    pairs = [(i, j) for i in range(len(T)) for j in range(len(T)) if i < j and np.isfinite(true_T[[i, j]]).all()]
    if not pairs:
        return (float("nan"),) * 3
    turned, still, aside = [], [], []
    for i, j in pairs:
        found, true = np.linalg.inv(T[i]) @ T[j], np.linalg.inv(true_T[i]) @ true_T[j]
        turned.append(_angle(found[:3, :3].T @ true[:3, :3]))
        still.append(_angle(true[:3, :3]))
        length = np.linalg.norm(true[:3, 3]), np.linalg.norm(found[:3, 3])
        if length[0] > 0.02:
            cos = found[:3, 3] @ true[:3, 3] / max(length[0] * length[1], 1e-12)
            aside.append(np.degrees(np.arccos(np.clip(cos, -1, 1))))
    return float(np.median(turned)), float(np.median(still)), float(np.median(aside)) if aside else float("nan")


def sparsification(error: F64, conf: NDArray) -> tuple[float, float]:
    """(area under the curve by confidence, area by the oracle), both over the mean error."""
    if not len(error) or error.mean() <= 0:
        return float("nan"), float("nan")
    keep = np.maximum(np.round((1 - SHARES) * len(error)).astype(int), 1)

    def area(order: NDArray) -> float:
        return float((np.cumsum(error[order])[keep - 1] / keep).mean() / error.mean())

    return area(np.argsort(-conf, kind="stable")), area(np.argsort(error, kind="stable"))


def _angle(R: F64) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))
