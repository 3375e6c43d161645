"""Interface of backends: two functions, and the files that they read; and their views, kept in memory."""

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


BUDGET = 512_000_000
"""Bytes: 80 views of 640 x 480. Of longer captures none is kept: every pass would push out what the next wants."""


class Kept:
    """A view's loader that keeps what it made, read-only, if all views fit into the budget."""

    def __init__(self, load: Callable[[int], PointView], views: int, budget: int = BUDGET) -> None:
        self._load, self._views, self._budget = load, views, budget
        self._kept: dict[int, PointView] = {}

    def __call__(self, i: int) -> PointView:
        """View i. Threads may ask at the same time: then both make it, and the same."""
        if i in self._kept:
            return self._kept[i]
        view = self._load(i)
        arrays = [a for a in (view.points, view.confidence, view.mask, view.color) if a is not None]
        if self._views * sum(a.nbytes for a in arrays) <= self._budget:
            for a in arrays:
                a.flags.writeable = False
            self._kept[i] = view
        return view
