"""Work on many views at a time, handed on in order: reading an image releases the interpreter, so threads help."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
THREADS = min(4, os.cpu_count() or 1)
ROWS = 8192
"""Rows of an array that are worked on at once: with what is made of them they fit a processor's cache."""


def in_order(function: Callable[[int], T], n: int) -> Iterator[T]:
    """function(0), function(1), ... a few at a time in threads, handed on in order, few results in memory."""
    with ThreadPoolExecutor(THREADS) as pool:
        waiting = deque(pool.submit(function, i) for i in range(min(n, 2 * THREADS)))
        for i in range(n):
            yield waiting.popleft().result()
            if i + 2 * THREADS < n:
                waiting.append(pool.submit(function, i + 2 * THREADS))


def by_rows(function: Callable[[slice], tuple[NDArray[Any], ...]], n: int) -> tuple[NDArray[Any], ...]:
    """The arrays that a function makes of some of `n` rows, of all of them: in threads, a few rows at a time."""
    starts = range(0, max(n, 1), ROWS)
    parts = in_order(lambda k: function(slice(starts[k], starts[k] + ROWS)), len(starts))
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
