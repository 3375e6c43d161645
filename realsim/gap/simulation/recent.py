"""What was made last, by key, for threads that share it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Made = TypeVar("Made")


class Recent(Generic[Made]):
    """The last few results of something that takes long; what was asked for last is forgotten last.

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
