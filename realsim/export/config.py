"""What can be set about the scene on disk."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SceneConfig:
    contact: str = "hfield"
    """Collision representation."""
    hfield_resolution: float = 0.02
    """Metres a cell of the collision height field."""
    convex_threshold: float = 0.01
    """Metres of concavity that a part of the convex decomposition may have."""
    robot: str | None = None
    """Robot to put on the start platform: `g1`, or `menagerie:NAME`."""
    drop_tolerance: float = 0.010
    """Metres by which an object dropped on a platform may rest beside that platform's height."""

    def __post_init__(self) -> None:
        if not 0.002 <= self.hfield_resolution <= 0.5:
            raise ValueError("hfield_resolution must lie between 0.002 and 0.5 metres")
        if self.drop_tolerance <= 0:
            raise ValueError("drop_tolerance must be positive")
