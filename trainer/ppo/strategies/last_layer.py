"""Last layer fine-tuning (paper, 4): the final linear layer of the actor."""

from __future__ import annotations

from torch import nn

from trainer.ppo.config import StrategyConfig
from trainer.ppo.strategies.base import freeze, own_noise, plain


def last_layer(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The policy itself, with only its output layer trainable."""
    actor = plain(policy, "last_layer")
    freeze(actor)
    actor.log_std = own_noise(actor, config)
    actor.trunk[-1].requires_grad_(True)
    return actor
