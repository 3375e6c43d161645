"""Uncertainty of the recovered depth gain.

The adjustment's own standard error counts every residual as independent. Pose errors drift and sensor errors have a
pattern over the image, so the error is also taken from how much groups of residuals pull the gain: the limit of the
bootstrap that draws groups with replacement, without its random numbers (infinitesimal jackknife, Jaeckel 1972;
Efron 1982, chapter 6).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64
from realsim.feedforward.rgbd.features import Tracks
from realsim.feedforward.rgbd.refine_adjust import GAIN_PRIOR, Step
from realsim.feedforward.rgbd.refine_pairs import Surface

SYSTEMATIC = 5e-4
"""Relative error that no regrouping of the residuals shows: focal length, sub-pixel offsets of features, a disparity
that is off by a constant. Set by hand: with exact poses of three rendered captures the gain was off by up to this from
the median ratio of true to measured depth."""


@dataclass(frozen=True)
class GainEstimate:
    """The gain as it should be applied."""

    value: float
    sigma: float
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)


def judge_gain(step: Step, tracks: Tracks, surface: Surface, n_frames: int, sensor_sigma: float | None) -> GainEstimate:
    """The gain with an honest standard error, or 1 where it is not observable.

    What the capture says and what is known of the sensor (1 with the relative standard error `sensor_sigma`) are two
    measurements of one gain, weighted by their variances. A gain that the capture tells no better than the sensor's own
    calibration is not applied. `sensor_sigma` None: not requested.
    """
    if sensor_sigma is None:
        return GainEstimate(1.0, float("inf"))
    errors = {
        f"blocks_of_{length}_frames": grouped_error(step.influence, step.owner // length)
        # Single frames, and blocks of neighbours (12 at least) for errors that drift.
        for length in sorted({1, max(1, n_frames // 24), max(1, n_frames // 12)})
    }
    cells = image_cells(tracks, surface)
    errors["image_cells"] = grouped_error(step.influence[: len(cells)], cells)
    by_frames = [v for name, v in errors.items() if name != "image_cells" and np.isfinite(v)]
    # Errors of poses and errors of the sensor's pattern are different errors: their squares add.
    parts = (max([step.gain_sigma, *by_frames]), errors["image_cells"], SYSTEMATIC)
    sigma = float(np.linalg.norm([part for part in parts if np.isfinite(part)]))
    found = step.state.gain
    statistics: dict[str, Any] = {
        "found": found,
        "sigma_if_independent": step.gain_sigma,
        "sigma_by_group": {name: e if np.isfinite(e) else None for name, e in errors.items()},
    }
    if sigma > sensor_sigma:
        sigma = max(sigma, min(step.gain_sigma, GAIN_PRIOR))
        text = (
            f"the depth scale cannot be determined from this capture (gain {found:.4f} ± {sigma:.4f}): "
            "too little baseline, or too few shared features; depth is used as the sensor gave it"
        )
        return GainEstimate(1.0, sigma, (text,), statistics)
    weight = 1 / (1 + (sigma / sensor_sigma) ** 2)
    return GainEstimate(1 + weight * (found - 1), float(np.sqrt(weight)) * sigma * found, (), statistics)


def grouped_error(influence: F64, group: NDArray[np.int64]) -> float:
    """Standard error of the sum of influences when whole groups are drawn with replacement."""
    total = np.bincount(group, influence)
    total = total[np.bincount(group) > 0]
    n = len(total)
    return float(np.sqrt(n / (n - 1) * ((total - total.mean()) ** 2).sum())) if n > 1 else float("inf")


def image_cells(tracks: Tracks, surface: Surface) -> NDArray[np.int64]:
    """(3M + K,) cell of the image, about 7 degrees wide, of each residual of tracks and surfaces."""
    xy = np.concatenate([np.repeat(tracks.xy, 3, axis=0), surface.p[:, :2] / np.maximum(surface.p[:, 2:], 1e-6)])
    cell = np.clip(np.floor(xy / 0.12).astype(int), -50, 49) + 50
    return cell[:, 0] * 100 + cell[:, 1]
