"""Options of the metric scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class ScaleConfig:
    method: Annotated[str, tyro.conf.arg(name="scale-method", metavar="{median,least_squares,ransac}")] = "median"
    """Estimator; `median` is the paper's rule."""
    warn_spread: float = 0.05
    """Relative spread between frames above which the report warns."""
    max_spread: float = 0.25
    """Relative spread between frames above which the scale is refused."""
    bootstrap: int = 1000
    """Resamples for the interval."""
    sensor_sigma: float | None = None
    """Relative standard error of the depth sensor's own scale; enters the interval if poses did not correct it
    (default: by the sensor: 0.006 of a depth camera, 0.04 of a phone's LiDAR)."""
    seed: Annotated[int, tyro.conf.Suppress] = 0

    def __post_init__(self) -> None:
        if not 0 < self.warn_spread <= self.max_spread:
            raise ValueError("need 0 < warn_spread <= max_spread")
        if self.sensor_sigma is not None and not 0 <= self.sensor_sigma < 0.5:
            raise ValueError("need 0 <= sensor_sigma < 0.5")
        if self.bootstrap < 10:
            raise ValueError("need bootstrap >= 10")
