"""Interface of backends: two functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from realsim.core.types import FrameSet, Pointmaps, Solution
from realsim.feedforward.config import PointsConfig


@dataclass(frozen=True)
class Backend:
    """How to find poses and points, and how to recompute the points of a view from the solution."""

    solve: Callable[[FrameSet, PointsConfig], Solution]
    """Everything slow. Its result is plain arrays and may be kept on disk."""
    pointmaps: Callable[[FrameSet, Solution, PointsConfig], Pointmaps]
    """Cheap: views are made when they are asked for."""
    inputs: Callable[[PointsConfig], tuple[Path, ...]] = lambda config: ()
    """Files besides the capture that a solution depends on (a model's)."""
