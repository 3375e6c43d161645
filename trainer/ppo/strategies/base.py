"""Shared parts of strategies."""

from __future__ import annotations

import math

import torch
from torch import nn

from trainer.errors import TrainerError
from trainer.ppo.config import StrategyConfig
from trainer.ppo.networks import Actor
from trainer.ppo.normaliser import Normaliser


def freeze(policy: nn.Module) -> nn.Module:
    """The policy with no parameter to be trained and its normalisers constant."""
    for parameter in policy.parameters():
        parameter.requires_grad_(False)
    for module in policy.modules():
        if isinstance(module, Normaliser):
            module.frozen = True
    return policy


def own_noise(policy: nn.Module, config: StrategyConfig) -> nn.Parameter:
    """A new exploration noise that starts at the base's, or where the configuration says."""
    old = policy.get_parameter("log_std")
    start = old.detach().clone() if config.start_std is None else torch.full_like(old, math.log(config.start_std))
    return nn.Parameter(start)


def plain(policy: nn.Module, strategy: str) -> Actor:
    """The policy, if it is one without adapters or residuals: its layers are known."""
    if not isinstance(policy, Actor):
        raise TrainerError(
            f"the strategy {strategy} starts from a plain policy",
            found=f"a policy already fine-tuned by {type(policy).__name__.lower()}",
            hint="use the base policy, or the strategy full or residual",
        )
    return policy
