"""Interface of backends: two functions, and the files that they read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from realsim.core.types import Frame, FrameSet, PointView, Solution
from realsim.feedforward.config import PointsConfig


@dataclass(frozen=True)
class Backend:
    """How to find poses and points, and how to recompute the points of a view from the solution."""

    solve: Callable[[FrameSet, PointsConfig], Solution]
    """Everything slow. Its result is plain arrays and may be kept on disk."""
    load_views: Callable[[tuple[Frame, ...], Solution], tuple[tuple[Frame, ...], Callable[[int], PointView]]]
    """(N used frames, solution) -> these frames as corrected, and what makes view i when it is needed. Cheap."""
    inputs: Callable[[PointsConfig], tuple[Path, ...]] = lambda config: ()
    """Files besides the capture that a solution depends on (a model's)."""
