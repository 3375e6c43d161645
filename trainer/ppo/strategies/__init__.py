"""Fine-tuning strategies: one file each, one line here.

A strategy takes a policy and gives one that computes bit for bit the same at the start, in which exactly the
strategy's own parameters require a gradient. The exploration noise `log_std` is always a parameter of the new policy:
it is no part of the function that is deployed. The observation normaliser is frozen with the base.
"""

from __future__ import annotations

from torch import nn

from realsim.core.registry import Registry
from trainer.ppo.config import StrategyConfig

STRATEGIES = Registry(
    "strategy",
    {
        "full": "trainer.ppo.strategies.full:full",
        "adapter": "trainer.ppo.strategies.adapter:adapter",
        "residual": "trainer.ppo.strategies.residual:residual",
        "last_layer": "trainer.ppo.strategies.last_layer:last_layer",
    },
)
"""name -> `(policy, config: StrategyConfig) -> policy`."""


def apply(name: str, policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The policy made ready for fine-tuning by the strategy of that name (see the module's text)."""
    return STRATEGIES[name](policy, config)
