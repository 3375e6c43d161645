"""Simulations on all cores: the runs of one, or several that do not wait for one another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from realsim.gap.simulation.sampling import quiet_mujoco

Item = TypeVar("Item")
Made = TypeVar("Made")


class Cores:
    """A fixed number of threads; MuJoCo's rollouts and NumPy's products let go of the interpreter meanwhile."""

    def __init__(self, threads: int) -> None:
        self._workers = ThreadPoolExecutor(threads) if threads > 1 else None
        self._here = threading.local()

    def each(self, function: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
        """`function` of every item, in the items' order; it must not change what it shares.

        Called by one that runs on these cores already, it does one after the other.
        """
        if self._workers is None or len(items) < 2 or getattr(self._here, "working", False):
            yield from map(function, items)
            return

        def work(item: Item) -> Made:
            self._here.working = True
            return function(item)

        with quiet_mujoco():  # beginning and ending with each simulation, it would end for all
            yield from self._workers.map(work, items)

    def close(self) -> None:
        """Let the threads go; what waits is not begun."""
        if self._workers is not None:
            self._workers.shutdown(cancel_futures=True)
            self._workers = None
