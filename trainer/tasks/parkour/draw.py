"""Random numbers from one generator, so that a run can be repeated and resumed."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor


class Dice(torch.Generator):
    """A generator that can give several rows the same numbers."""

    rows: Tensor | None = None

    @contextmanager
    def repeated(self, rows: Tensor) -> Iterator[None]:
        """Draws of K rows within have in row i what row `rows[i]` (K,) drew: equal inputs then become equal worlds."""
        self.rows = rows
        try:
            yield
        finally:
            self.rows = None


def rand(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Numbers between 0 and 1, on the generator's device."""
    return _rows(torch.rand(shape, generator=generator, device=generator.device), generator)


def randn(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Normally distributed numbers."""
    return _rows(torch.randn(shape, generator=generator, device=generator.device), generator)


def randint(low: int, high: int, count: int, generator: torch.Generator) -> Tensor:
    """(count,) integers from `low` to `high` - 1."""
    return _rows(torch.randint(low, high, (count,), generator=generator, device=generator.device), generator)


def uniform(bounds: tuple[float, float], shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Numbers between the bounds."""
    low, high = bounds
    return low + (high - low) * rand(shape, generator)


def symmetric(width: float, shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Numbers between -width and +width."""
    return uniform((-width, width), shape, generator)


def _rows(drawn: Tensor, generator: torch.Generator) -> Tensor:
    rows = getattr(generator, "rows", None)
    return drawn if rows is None else drawn[rows]
