"""Options of the metric scale."""

import re
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from realsim.core.limits import check_limits

SHEETS = {"a4": (0.297, 0.210), "letter": (0.2794, 0.2159)}
"""Metres, the long side first."""


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
    known_length: Annotated[tuple[str, str, float] | None, tyro.conf.arg(metavar="A B METRES")] = None
    """Two points and their distance, which sets the scale: each as FRAME:X,Y, pixels of the frame's colour image."""
    tag_size: Annotated[float | None, tyro.conf.arg(metavar="METRES")] = None
    """Side of the black square of printed tags in view (AprilTag 36h11 or 25h9, ArUco), which set the scale."""
    sheet: Literal["a4", "letter"] | None = None
    """A sheet of paper lies in view, flat and whole, and sets the scale."""
    seed: Annotated[int, tyro.conf.Suppress] = 0

    def __post_init__(self) -> None:
        if not 0 < self.warn_spread <= self.max_spread:
            raise ValueError(f"need 0 < warn_spread <= max_spread, found {self.warn_spread:g} and {self.max_spread:g}")
        if self.sensor_sigma is not None and not 0 <= self.sensor_sigma < 0.5:
            raise ValueError(f"need 0 <= sensor_sigma < 0.5, found {self.sensor_sigma:g}")
        check_limits(self, least={"bootstrap": 10})
        if sum(given is not None for given in (self.known_length, self.tag_size, self.sheet)) > 1:
            raise ValueError("only one of known_length, tag_size and sheet can set the scale")
        if self.known_length is not None:
            if not 0 < self.known_length[2] < 1000:
                raise ValueError(f"known_length must end in a distance in metres, found {self.known_length[2]:g}")
            for name in self.known_length[:2]:
                if re.fullmatch(r".+:\d+(\.\d+)?,\d+(\.\d+)?", name) is None:
                    raise ValueError(f"known_length takes FRAME:X,Y twice and metres, not {name}")
        if self.tag_size is not None and not 0.005 <= self.tag_size <= 5:
            raise ValueError(f"tag_size is in metres: need 0.005 <= tag_size <= 5, found {self.tag_size:g}")
