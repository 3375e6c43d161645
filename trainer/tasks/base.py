"""Interface of environments: a batch of worlds, observations by group, rewards, ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor


@dataclass(frozen=True)
class ObservationLayout:
    """Names and shapes, in order: written into checkpoints and ONNX metadata, and compared when a policy is loaded."""

    actor: tuple[tuple[str, int], ...]
    """(term, width) of the flat proprioceptive vector, history included."""
    critic: tuple[tuple[str, int], ...]
    depth: tuple[int, int, int] | None
    """(frames, height, width) of the actor's depth stack; None without a camera."""
    actions: tuple[str, ...]
    """Joint names."""
    depth_stride: int = 0
    """Policy steps between the frames of the stack, newest first: frame k is that of k strides ago, or the episode's
    first where that lies before it. A learner may then keep each frame once. 0: unknown, whole stacks are kept."""

    @property
    def actor_width(self) -> int:
        return sum(width for _, width in self.actor)

    @property
    def critic_width(self) -> int:
        return sum(width for _, width in self.critic)

    def zeros(self, worlds: int, device: torch.device) -> Observation:
        """Room for what `worlds` worlds observe."""
        actor, critic = (torch.zeros(worlds, width, device=device) for width in (self.actor_width, self.critic_width))
        return Observation(actor, critic, self.depth and torch.zeros(worlds, *self.depth, device=device))


@dataclass
class Observation:
    """float32 on the environment's device."""

    actor: Tensor
    """(N, A)."""
    critic: Tensor
    """(N, C) privileged, noise-free."""
    depth: Tensor | None
    """(N, M, H, W) in 0..1 (0 near, 1 at the far limit or nothing); the critic sees it too."""

    def map(self, f: Any) -> Observation:
        """The same with `f` applied to every tensor."""
        return Observation(f(self.actor), f(self.critic), None if self.depth is None else f(self.depth))

    def tensors(self) -> list[Tensor]:
        """Those that there are."""
        return [x for x in (self.actor, self.critic, self.depth) if x is not None]


@dataclass
class Step:
    """Result of one policy step; worlds that ended are already reset and `observation` is of the new episode.

    An environment with `graphs` writes the tensors of its next step over these.
    """

    observation: Observation
    reward: Tensor
    """(N,) sum of weighted terms times the policy step, AMP excluded."""
    terminated: Tensor
    """(N,) bool: failed or reached an absorbing end."""
    truncated: Tensor
    """(N,) bool: time ran out; its value is bootstrapped from `final_observation`."""
    final_observation: Observation | None
    """The true last observation of worlds that ended at this step (rows of other worlds are unspecified); None if none
    did. The next step at which some do may write over it."""
    amp: Tensor | None = None
    """(N, S) transition features for the discriminator; None when AMP is off."""
    log: dict[str, float] = field(default_factory=dict)
    """Means for TensorBoard: reward terms, success rate, terrain level, failures by reason, resets after divergence."""
    ended: int | None = None
    """How many worlds ended, if the environment has asked the device."""


class VecEnv(Protocol):
    """A batch of worlds behind two methods."""

    num_worlds: int
    num_actions: int
    device: torch.device
    layout: ObservationLayout
    policy_dt: float
    max_steps: int
    """Policy steps of a whole episode."""
    graphs: bool
    """Whether a step is made of CUDA graphs (`trainer.graphs`); a learner's part of it then is, too."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the figures doubtful, so far."""

    def reset(self) -> Observation:
        """Start all worlds anew (episode ages spread at random, so that they do not end together)."""

    def step(self, actions: Tensor) -> Step:
        """One policy step with actions (N, num_actions)."""

    def ease(self) -> None:
        """Make the task easier: asked when training has lost what the policy knew."""

    def state_dict(self) -> dict[str, Any]:
        """Curriculum levels and random generators: with the learner's state enough to resume exactly at a reset."""

    def load_state_dict(self, state: dict[str, Any], seed: int | None = None) -> None:
        """The inverse; `seed`: draw anew from this one instead of going on where the saved random numbers ended."""
