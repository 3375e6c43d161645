"""Adversarial motion prior (Peng et al. 2021): a discriminator D that tells reference motion from the policy's.

Least-squares loss, D -> 1 on reference and -1 on the policy, a gradient penalty on reference motion, and the style
reward of the paper's table, weight * max[0, 1 - 0.25 (D - 1)^2], times the policy step like every other term.
"""

from typing import Any

import torch
from torch import Tensor, nn

from trainer.errors import TrainerError
from trainer.ppo.config import AmpConfig
from trainer.ppo.distributed import average_gradients
from trainer.ppo.networks import perceptron, through
from trainer.ppo.normaliser import Normaliser


class StylePrior(nn.Module):
    """Discriminator, its optimiser, and the features of the policy's motion since the last update.

    Args:
        reference: (K, S) transition features of reference motion; the normaliser is fitted to them and then constant.
        config: see `AmpConfig`.
        policy_dt: seconds a policy step.
        minibatches: gradient steps an iteration.
    """

    reference: Tensor

    def __init__(self, reference: Tensor, config: AmpConfig, policy_dt: float, minibatches: int = 4) -> None:
        super().__init__()
        if reference.ndim != 2 or not len(reference) or not bool(torch.isfinite(reference).all()):
            raise TrainerError("no usable reference motion", found=f"features of shape {tuple(reference.shape)}")
        self.config, self.policy_dt, self.minibatches = config, policy_dt, minibatches
        width = reference.shape[1]
        self.normaliser = Normaliser(width)
        self.normaliser.update(reference)
        self.normaliser.frozen = True
        self.layers = perceptron(width, config.amp_hidden, 1)
        self.register_buffer("reference", reference.float(), persistent=False)
        self.to(reference.device)
        self.optimiser = torch.optim.Adam(self.layers.parameters(), lr=config.amp_learning_rate)
        self.seen: list[Tensor] = []

    def forward(self, features: Tensor) -> Tensor:
        """D (N,) of transition features (N, S)."""
        return self._judge(self.normaliser(features))

    @torch.no_grad()
    def reward(self, features: Tensor) -> Tensor:
        """Style reward (N,) of what the policy just did; the features are kept for the update."""
        self.seen.append(features.clone())
        return self.config.amp_weight * self.policy_dt * style_reward(self(features))

    def update(self, rng: torch.Generator) -> dict[str, Tensor]:
        """One pass over the policy's features since the last update, each minibatch against as much reference."""
        motion = torch.cat(self.seen)
        self.seen.clear()
        order = torch.randperm(len(motion), generator=rng, device=motion.device)
        totals: dict[str, Tensor] = {}
        for rows in order.chunk(self.minibatches):
            picks = torch.randint(len(self.reference), (len(rows),), generator=rng, device=motion.device)
            losses = self._losses(self.reference[picks], motion[rows])
            self.optimiser.zero_grad()
            losses["amp_loss"].backward()
            average_gradients(self.layers.parameters())
            self.optimiser.step()
            for name, value in losses.items():
                totals[name] = totals.get(name, 0) + value.detach() / self.minibatches
        return totals

    def state_dict(self, *args: object, **kwargs: object) -> dict[str, object]:  # type: ignore[override]
        """Networks and optimiser."""
        return {"layers": self.layers.state_dict(), "adam": self.optimiser.state_dict()}

    def load_state_dict(self, state: dict[str, Any], *args: object, **kwargs: object) -> None:  # type: ignore[override]
        """The inverse."""
        self.layers.load_state_dict(state["layers"])
        self.optimiser.load_state_dict(state["adam"])

    def _judge(self, normalised: Tensor) -> Tensor:
        return through(self.layers, normalised).squeeze(-1)

    def _losses(self, reference: Tensor, motion: Tensor) -> dict[str, Tensor]:
        real = self.normaliser(reference).requires_grad_(True)
        on_real, on_motion = self._judge(real), self._judge(self.normaliser(motion))
        (gradient,) = torch.autograd.grad(on_real.sum(), real, create_graph=True)
        penalty = gradient.square().sum(-1).mean()
        squares = (on_real - 1).square().mean() + (on_motion + 1).square().mean()
        loss = 0.5 * squares + 0.5 * self.config.amp_gradient_penalty * penalty
        return {"amp_loss": loss, "amp_real": on_real.mean(), "amp_policy": on_motion.mean(), "amp_penalty": penalty}


def style_reward(judgement: Tensor) -> Tensor:
    """max[0, 1 - 0.25 (D - 1)^2]: 1 where the discriminator takes it for reference, 0 where it is sure that not."""
    return (1 - 0.25 * (judgement - 1).square()).clamp(min=0)
