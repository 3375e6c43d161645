"""Work on many views at a time, handed on in order: reading an image releases the interpreter, so threads help."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
THREADS = min(4, os.cpu_count() or 1)


def in_order(function: Callable[[int], T], n: int) -> Iterator[T]:
    """function(0), function(1), ... a few at a time in threads, handed on in order, few results in memory."""
    with ThreadPoolExecutor(THREADS) as pool:
        waiting = deque(pool.submit(function, i) for i in range(min(n, 2 * THREADS)))
        for i in range(n):
            yield waiting.popleft().result()
            if i + 2 * THREADS < n:
                waiting.append(pool.submit(function, i + 2 * THREADS))
