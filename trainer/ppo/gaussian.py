"""A diagonal Gaussian, in the three formulas that PPO needs. Means are (N, J), `log_std` is (J,)."""

import math

import torch
from torch import Tensor

SMALLEST = 0.02
"""Standard deviation below which a sure policy may not narrow its noise: it would stop learning."""


def bounded(log_std: Tensor, largest: float) -> Tensor:
    """The logarithm of the standard deviation within bounds; beyond them it gets no gradient, see `keep_within`."""
    return log_std.clamp(math.log(SMALLEST), math.log(largest))


@torch.no_grad()
def keep_within(log_std: Tensor, largest: float) -> None:
    """Put the parameter itself back to its bounds, after a step of its optimiser: beyond it could never learn again."""
    log_std.clamp_(math.log(SMALLEST), math.log(largest))


def sample(mean: Tensor, log_std: Tensor, generator: torch.Generator) -> Tensor:
    """One action a row."""
    noise = torch.empty_like(mean).normal_(generator=generator)
    return mean + log_std.exp() * noise


def log_prob(action: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """(N,) logarithm of the density."""
    z = (action - mean) * torch.exp(-log_std)
    return -0.5 * (z.square() + 2 * log_std + math.log(2 * math.pi)).sum(-1)


def entropy(log_std: Tensor) -> Tensor:
    """() differential entropy: the same for every state."""
    return (log_std + 0.5 * (1 + math.log(2 * math.pi))).sum()


def divergence(old_mean: Tensor, old_log_std: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """(N,) Kullback-Leibler divergence of the new Gaussian from the old one."""
    variances = torch.exp(2 * (old_log_std - log_std)) + ((mean - old_mean) * torch.exp(-log_std)).square()
    return (log_std - old_log_std + 0.5 * (variances - 1)).sum(-1)
