"""Full fine-tuning (paper, section on strategies, 1): every parameter of the policy."""

from __future__ import annotations

from torch import nn

from trainer.ppo.config import StrategyConfig
from trainer.ppo.strategies.base import freeze, own_noise


def full(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The policy itself, all of it trainable; the normaliser stays as it was."""
    freeze(policy)
    policy.log_std = own_noise(policy, config)
    return policy.requires_grad_(True)
