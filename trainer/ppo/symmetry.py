"""Left-right symmetry, taught by samples: what the policy does in the mirror is its mirror image."""

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from trainer.ppo.storage import Batch
from trainer.tasks import Observation


class Mirror(Protocol):
    """Reflects observations and actions about the robot's sagittal plane (`trainer.tasks.parkour.symmetry`)."""

    def observation(self, o: Observation) -> Observation:
        """The mirrored observation."""

    def action(self, a: Tensor) -> Tensor:
        """(N, J) the mirrored actions."""


class MirrorSamples:
    """Every sample a second time in the mirror, with the probability, value and advantage that it had (Mittal et al.
    2024, "Symmetry considerations for learning task symmetric robot policies")."""

    def __init__(self, mirror: Mirror) -> None:
        self.mirror = mirror

    def __call__(self, b: Batch) -> Batch:
        o, mirrored = b.observation, self.mirror.observation(b.observation)
        observation = Observation(
            torch.cat([o.actor, mirrored.actor]),
            torch.cat([o.critic, mirrored.critic]),
            _joined(o.depth, mirrored.depth),
        )
        return replace(
            b,
            observation=observation,
            action=torch.cat([b.action, self.mirror.action(b.action)]),
            mean=torch.cat([b.mean, self.mirror.action(b.mean)]),
            log_prob=b.log_prob.repeat(2),
            value=b.value.repeat(2),
            returns=b.returns.repeat(2),
            advantage=b.advantage.repeat(2),
        )


def _joined(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    return None if a is None or b is None else torch.cat([a, b])
