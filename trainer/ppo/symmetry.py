"""Left-right symmetry as a loss: what the policy does in the mirror should be the mirror image of what it does."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor, nn

from trainer.ppo.storage import Batch
from trainer.tasks import Observation


class Mirror(Protocol):
    """Reflects observations and actions about the robot's sagittal plane (`trainer.tasks.parkour.symmetry`)."""

    def observation(self, o: Observation) -> Observation:
        """The mirrored observation."""

    def action(self, a: Tensor) -> Tensor:
        """(N, J) the mirrored actions."""


class SymmetryLoss:
    """Mean squared difference between the action in the mirror and the mirrored action (Yu et al. 2018, equation 4)."""

    def __init__(self, mirror: Mirror) -> None:
        self.mirror = mirror

    def __call__(self, policy: nn.Module, batch: Batch) -> Tensor:
        o = self.mirror.observation(batch.observation)
        # The target is held fixed: both sides moving would let the loss pull a good action to a bad one's image.
        target = self.mirror.action(policy(batch.observation.actor, batch.observation.depth).detach())
        return (policy(o.actor, o.depth) - target).square().mean()
