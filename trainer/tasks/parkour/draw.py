"""Random numbers from one generator, so that a run can be repeated and resumed."""

from __future__ import annotations

import torch
from torch import Tensor


def uniform(bounds: tuple[float, float], shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Numbers between the bounds, on the generator's device."""
    low, high = bounds
    return low + (high - low) * torch.rand(shape, generator=generator, device=generator.device)


def symmetric(width: float, shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Numbers between -width and +width."""
    return uniform((-width, width), shape, generator)
