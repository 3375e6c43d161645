"""Adapters (paper, 2): after each layer of encoder and perceptron, x + up(elu(down(x))) with `up` zero at the start.

A convolution's adapter is the same with 1x1 convolutions: it mixes channels at every pixel.
"""

from __future__ import annotations

from typing import cast

from torch import Tensor, nn

from trainer.ppo.config import StrategyConfig
from trainer.ppo.networks import Actor, Block, joined, through
from trainer.ppo.normaliser import Normaliser
from trainer.ppo.strategies.base import freeze, own_noise, plain


class Bottleneck(nn.Module):
    """x + up(elu(down(x))); exactly x until `up` has learnt something."""

    def __init__(self, block: Block, width: int) -> None:
        super().__init__()
        convolution = isinstance(block.layer, nn.Conv2d)
        self.down: nn.Module
        self.up: nn.Module
        if convolution:
            self.down, self.up = nn.Conv2d(block.out_features, width, 1), nn.Conv2d(width, block.out_features, 1)
        else:
            self.down, self.up = nn.Linear(block.out_features, width), nn.Linear(width, block.out_features)
        for parameter in self.up.parameters():
            nn.init.zeros_(parameter)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.up(nn.functional.elu(self.down(x)))


class Adapter(nn.Module):
    """A frozen base with a bottleneck after each of its layers."""

    def __init__(self, base: Actor, config: StrategyConfig) -> None:
        super().__init__()
        self.log_std = own_noise(base, config)
        freeze(base)
        self.base = base
        self.width, self.depth, self.config = base.width, base.depth, base.config
        self.encoder = _adapted(base.encoder, config.adapter_width)
        self.trunk = _adapted(base.trunk, config.adapter_width)

    @property
    def normaliser(self) -> Normaliser:
        return self.base.normaliser

    def forward(self, vector: Tensor, depth: Tensor | None) -> Tensor:
        x = joined(self.normaliser(vector), _between(self.base.encoder, self.encoder), depth)
        return through(_between(self.base.trunk, self.trunk), x)


def adapter(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The policy frozen, with adapters."""
    base = plain(policy, "adapter")
    return Adapter(base, config).to(base.log_std.device)


def _adapted(blocks: nn.ModuleList, width: int) -> nn.ModuleList:
    return nn.ModuleList(Bottleneck(cast(Block, block), width) for block in blocks)


def _between(blocks: nn.ModuleList, adapters: nn.ModuleList) -> list[nn.Module]:
    """Each block, then its adapter."""
    return [module for pair in zip(blocks, adapters, strict=True) for module in pair]
