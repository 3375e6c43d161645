"""What can be set about reading a capture."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CaptureConfig:
    layout: str = "auto"
    """Capture layout; `auto` recognises it."""
    max_frames: int = 300
    """At most this many frames are used, picked by sharpness and view change; 0 for all."""
    every: int = 1
    """Use every n-th frame."""
    depth_unit: float | None = None
    """Metres a step of integer depth images; from the layout if not given."""
    min_depth: float = 0.15
    """Metres; nearer depth is invalid."""
    max_depth: float = 6.0
    """Metres; farther depth is invalid."""
    unit: str = "m"
    """Unit of scans without one: m, cm, mm or inch."""

    def __post_init__(self) -> None:
        if self.max_frames < 0:
            raise ValueError("max_frames must not be negative")
        if self.every < 1:
            raise ValueError("every must be at least 1")
        if not 0 <= self.min_depth < self.max_depth:
            raise ValueError("need 0 <= min_depth < max_depth")
        if self.unit not in ("m", "cm", "mm", "inch"):
            raise ValueError("unit must be one of m, cm, mm, inch")
