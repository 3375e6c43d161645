"""Fine-tuning strategies, one function each (paper, section on strategies).

A strategy takes a policy and gives one that computes bit for bit the same at the start, in which exactly the
strategy's own parameters require a gradient. The exploration noise `log_std` is always a parameter of the new policy:
it is no part of the function that is deployed. The observation normaliser is frozen with the base.
"""

import math
from typing import cast

import torch
from torch import Tensor, nn

from realsim.core.registry import Registry
from trainer.errors import TrainerError
from trainer.ppo.config import StrategyConfig
from trainer.ppo.networks import Actor, Block, Core, joined, through
from trainer.ppo.normaliser import Normaliser

STRATEGIES = Registry("strategy", {n: f"{__name__}:{n}" for n in ("full", "adapter", "residual", "last_layer")})
"""name -> `(policy, config: StrategyConfig) -> policy`."""


def full(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """Every parameter of the policy (1); the normaliser stays as it was."""
    freeze(policy)
    policy.log_std = own_noise(policy, config)
    return policy.requires_grad_(True)


def last_layer(policy: nn.Module, config: StrategyConfig) -> nn.Module:
    """The final linear layer of the actor (4)."""
    actor = plain(policy, "last_layer")
    freeze(actor)
    actor.log_std = own_noise(actor, config)
    actor.trunk[-1].requires_grad_(True)
    return actor


class Bottleneck(nn.Module):
    """x + up(elu(down(x))); exactly x until `up` has learnt something. A convolution's has 1x1 convolutions: it mixes
    channels at every pixel."""

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
    """A frozen base with a bottleneck after each layer of encoder and perceptron (2)."""

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


class Residual(nn.Module):
    """a_total = a_base + a_res (3): a frozen policy plus a network of its own over the same normalised observation."""

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
