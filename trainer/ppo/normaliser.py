"""Running normalisation of observations."""

import torch
from torch import Tensor, nn

from trainer.ppo.distributed import all_sum

LARGEST = 10.0
"""Standard deviations beyond which an input is clipped: a fall must not blind the network for everything else."""
MEMORY = 2e8
"""Samples over which moments are averaged: with all of history they would no longer follow a curriculum."""


class Normaliser(nn.Module):
    """(x - mean) / std with the mean and variance of what was seen, over all ranks; the latest `MEMORY` samples count.

    Moments are kept in float64: after 1e10 samples a float32 sum has no digit left for a new one. What the forward
    pass uses is their float32 image. Frozen, it is a constant: a fine-tuned policy keeps its base's normalisation, or
    it would not be the base's function at the first step.
    """

    mean: Tensor
    inverse_std: Tensor
    moments: Tensor
    count: Tensor

    def __init__(self, width: int, eps: float = 1e-2) -> None:
        super().__init__()
        self.eps = eps
        self.frozen = False
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("inverse_std", torch.ones(width))
        self.register_buffer("moments", torch.stack([torch.zeros(width), torch.ones(width)]).double())
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def forward(self, x: Tensor) -> Tensor:
        return ((x - self.mean) * self.inverse_std).clamp(-LARGEST, LARGEST)

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Take in observations (..., width), with those of all other ranks (Chan et al. 1979, combined moments)."""
        if self.frozen:
            return
        x = x.flatten(0, -2)
        one = torch.ones(1, dtype=torch.float64, device=x.device)
        sums = all_sum(torch.cat([one * len(x), x.sum(0).double()]))
        n, batch_mean = sums[0], sums[1:] / sums[0]
        # Squares about the mean, not of the values: a term far from zero that hardly varies would lose all digits.
        batch_variance = all_sum((x - batch_mean.float()).square().sum(0).double()) / n
        mean, variance = self.moments
        delta = batch_mean - mean
        total = self.count + n
        rate = n / total
        mean = mean + rate * delta
        variance = variance + rate * (batch_variance - variance + delta.square() * (1 - rate))
        self.moments.copy_(torch.stack([mean, variance]))
        self.count.copy_(total.clamp_max(MEMORY))
        self.mean.copy_(mean.float())
        self.inverse_std.copy_(1 / (variance.sqrt() + self.eps).float())
