"""Residual learning (paper, 3): a_total = a_base + a_res; the base frozen, the residual zero at the start."""

from __future__ import annotations

from torch import Tensor, nn

from trainer.ppo.config import StrategyConfig
from trainer.ppo.networks import Core
from trainer.ppo.normaliser import Normaliser
from trainer.ppo.strategies.base import freeze, own_noise


class Residual(nn.Module):
    """A frozen policy plus a network of its own encoder and perceptron over the same normalised observation."""

    def __init__(self, base: nn.Module, config: StrategyConfig) -> None:
        super().__init__()
        self.log_std = own_noise(base, config)
        self.base = freeze(base)
        self.width, self.depth, self.config = base.width, base.depth, base.config
        self.correction = Core(self.width, self.depth, config.residual_hidden, len(self.log_std), self.config)  # type: ignore[arg-type]
        for parameter in self.correction.trunk[-1].parameters():
            nn.init.zeros_(parameter)

    @property
    def normaliser(self) -> Normaliser:
        return self.base.normaliser  # type: ignore[return-value]

    def forward(self, vector: Tensor, depth: Tensor | None) -> Tensor:
        return self.base(vector, depth) + self.correction(self.normaliser(vector), depth)


def residual(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The policy frozen, with a correction added to its actions."""
    return Residual(policy, config).to(policy.get_parameter("log_std").device)
