"""Views kept in memory: scale, alignment and meshing each pass over all of them."""

from __future__ import annotations

from collections.abc import Callable

from realsim.core.types import PointView

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
