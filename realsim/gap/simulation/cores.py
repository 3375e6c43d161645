"""Simulations on all cores, and the last of them by what they were of."""

import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

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


class Recent(Generic[Made]):
    """The last few results of something that takes long; what was requested last is forgotten last.

    Two threads that ask for the same at once both make it: no thread waits for another one's simulation.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.made = 0
        """How many were made, not found."""
        self._made: dict[Hashable, Made] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The result for this key, made if it is not there."""
        with self._lock:
            if key in self._made:
                self._made[key] = found = self._made.pop(key)
                return found
        found = make()
        with self._lock:
            self._made[key] = found
            self.made += 1
            if len(self._made) > self.most:
                self._made.pop(next(iter(self._made)))
        return found
