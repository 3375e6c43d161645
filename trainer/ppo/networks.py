"""Actor and critic: a small convolutional depth encoder, a multilayer perceptron, a diagonal Gaussian.

A network is a list of blocks (one linear or convolutional layer with its activation), so that a strategy can put an
adapter after each without knowing what is inside. Depth frames are the channels of one image: the first convolution
sees motion, and a stack costs little more than a frame.
"""

import math
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor, nn

from trainer.ppo.config import NetworkConfig
from trainer.ppo.normaliser import Normaliser
from trainer.tasks import Observation, ObservationLayout


class Block(nn.Module):
    """A layer and its activation."""

    def __init__(self, layer: nn.Module, out_features: int, *, active: bool = True, flatten: bool = False) -> None:
        super().__init__()
        self.layer = layer
        self.out_features = out_features
        self.active = active
        self.flatten = flatten

    def forward(self, x: Tensor) -> Tensor:
        y = self.layer(x.flatten(1) if self.flatten else x)
        return nn.functional.elu(y) if self.active else y


class DepthConv(nn.Conv2d):
    """A 3 x 3 convolution that halves the image.

    On a GPU it runs with channels last and their number rounded up to eight: five frames, as they come, keep the tensor
    cores idle, and half of the time of an update went into two such layers.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 3, stride=2, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        if not x.is_cuda:
            return super().forward(x)
        image, weight = (_for_tensor_cores(t, -self.in_channels % 8) for t in (x, self.weight))
        return nn.functional.conv2d(image, weight, self.bias, self.stride, self.padding)


def _for_tensor_cores(x: Tensor, missing: int) -> Tensor:
    x = x.to(torch.bfloat16)
    if missing:
        x = nn.functional.pad(x, (0, 0, 0, 0, 0, missing))
    return x.contiguous(memory_format=torch.channels_last)


def perceptron(inputs: int, hidden: Iterable[int], outputs: int) -> nn.ModuleList:
    """Blocks of a multilayer perceptron; the last has no activation and starts near zero."""
    blocks = []
    for width in hidden:
        blocks.append(Block(_orthogonal(nn.Linear(inputs, width), math.sqrt(2)), width))
        inputs = width
    blocks.append(Block(_orthogonal(nn.Linear(inputs, outputs), 0.01), outputs, active=False))
    return nn.ModuleList(blocks)


def depth_encoder(shape: tuple[int, int, int], config: NetworkConfig) -> nn.ModuleList:
    """Blocks from a depth stack (N, M, H, W) to a latent (N, L)."""
    channels, height, width = shape
    blocks: list[Block] = []
    for out in config.channels:
        blocks.append(Block(DepthConv(channels, out), out))
        channels, height, width = out, (height + 1) // 2, (width + 1) // 2
    latent = _orthogonal(nn.Linear(channels * height * width, config.latent), math.sqrt(2))
    blocks.append(Block(latent, config.latent, flatten=True))
    return nn.ModuleList(blocks)


class Core(nn.Module):
    """Normalised vector (N, width) and depth (N, M, H, W) into a perceptron, the depth through an encoder."""

    def __init__(
        self,
        width: int,
        depth: tuple[int, int, int] | None,
        hidden: tuple[int, ...],
        outputs: int,
        config: NetworkConfig,
    ) -> None:
        super().__init__()
        self.width, self.depth, self.config = width, depth, config
        self.encoder = nn.ModuleList() if depth is None else depth_encoder(depth, config)
        self.trunk = perceptron(width + (0 if depth is None else config.latent), hidden, outputs)

    def forward(self, x: Tensor, depth: Tensor | None) -> Tensor:
        return through(self.trunk, joined(x, self.encoder, depth))


class Network(Core):
    """A core behind a running normaliser."""

    def __init__(
        self,
        width: int,
        depth: tuple[int, int, int] | None,
        hidden: tuple[int, ...],
        outputs: int,
        config: NetworkConfig,
    ) -> None:
        super().__init__(width, depth, hidden, outputs, config)
        self.normaliser = Normaliser(width)

    def forward(self, vector: Tensor, depth: Tensor | None) -> Tensor:
        return super().forward(self.normaliser(vector), depth)


class Actor(Network):
    """Mean action (N, J) of a Gaussian whose standard deviation does not depend on the observation.

    Every policy that a strategy makes has the same face: called with (vector, depth) it gives the mean; `log_std` (J,);
    `normaliser`.
    """

    def __init__(self, layout: ObservationLayout, config: NetworkConfig) -> None:
        super().__init__(layout.actor_width, layout.depth, config.actor, len(layout.actions), config)
        self.log_std = nn.Parameter(torch.full((len(layout.actions),), math.log(config.std)))


class Critic(Network):
    """Value (N,) of the privileged state and, through an encoder of its own, of the depth that the actor sees.

    The encoder is not shared with the actor: a strategy that freezes the actor's must not freeze what the value
    function can see, and value gradients must not move a policy that is to stay as it is.
    """

    def __init__(self, layout: ObservationLayout, config: NetworkConfig) -> None:
        depth = layout.depth if config.critic_depth else None
        super().__init__(layout.critic_width, depth, config.critic, 1, config)

    def forward(self, vector: Tensor, depth: Tensor | None) -> Tensor:
        return super().forward(vector, depth).squeeze(-1)

    def of(self, observation: Observation) -> Tensor:
        """Value (N,) of an observation."""
        return self(observation.critic, observation.depth)


def through(blocks: Iterable[nn.Module], x: Tensor) -> Tensor:
    """`x` through all blocks."""
    for block in blocks:
        x = block(x)
    return x


def joined(x: Tensor, encoder: Sequence[nn.Module] | nn.ModuleList, depth: Tensor | None) -> Tensor:
    """The trunk's input: the vector and, if there is an encoder, the latent of the depth.

    On a GPU the encoder runs in bfloat16, when acting as in the update: its rounding lies far below the camera's noise.
    """
    if not len(encoder):
        return x
    if depth is None:
        raise ValueError("a network with a depth encoder needs depth")
    with torch.autocast(depth.device.type, torch.bfloat16, enabled=depth.is_cuda):
        latent = through(encoder, depth - 0.5)
    return torch.cat([x, latent.float()], dim=-1)


def _orthogonal(layer: nn.Linear, gain: float) -> nn.Linear:
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
