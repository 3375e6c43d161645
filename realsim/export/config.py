"""What can be set about the scene on disk."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SceneConfig:
    contact: str = "hfield"
    """Collision representation."""
    hfield_resolution: float = 0.02
    """Metres a cell of the collision height field."""
    robot: str | None = None
    """Robot to put on the start platform: `g1`, or `menagerie:NAME`."""
