"""Random numbers of one batch: all from one generator on one device, so that a seed gives a batch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Draw:
    """Draws from a seeded generator. The same seed gives the same numbers on the same kind of device."""

    generator: torch.Generator

    @classmethod
    def of(cls, seed: int, index: int, device: torch.device | str) -> Draw:
        """The generator of batch `index` of the stream `seed`."""
        generator = torch.Generator(device)
        generator.manual_seed((seed * 1_000_003 + index * 7919 + 12345) % 2**63)
        return cls(generator)

    @property
    def device(self) -> torch.device:
        """Where the numbers are made."""
        return self.generator.device

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform in [low, high)."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform in the logarithm."""
        return self.uniform(math.log(low), math.log(high), *shape).exp()

    def normal(self, sigma: float, *shape: int) -> Tensor:
        """Gaussian of zero mean."""
        return sigma * torch.randn(shape, generator=self.generator, device=self.device)

    def chance(self, p: float, *shape: int) -> Tensor:
        """True with probability `p`."""
        return torch.rand(shape, generator=self.generator, device=self.device) < p

    def below(self, count: int, *shape: int) -> Tensor:
        """Whole numbers 0 .. count - 1."""
        return torch.randint(count, shape, generator=self.generator, device=self.device)

    def choice(self, weights: Sequence[float], *shape: int) -> Tensor:
        """Indices with probabilities proportional to `weights`."""
        edges = torch.tensor(weights, device=self.device).cumsum(0)
        return torch.searchsorted(edges / edges[-1], self.uniform(0, 1, *shape)).clamp(max=len(weights) - 1)
