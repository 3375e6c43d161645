"""A policy with all that is needed to use it: what it sees, for which robot, how it came to be."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from trainer.errors import TrainerError
from trainer.ppo.config import NetworkConfig, StrategyConfig
from trainer.ppo.networks import Actor, Critic
from trainer.ppo.strategies import STRATEGIES
from trainer.tasks import Observation, ObservationLayout


@dataclass
class Policy:
    """Actor and critic over one observation layout; `tuned` lists the strategies that were applied, in order."""

    actor: nn.Module
    critic: Critic
    layout: ObservationLayout
    networks: NetworkConfig
    robot: str
    tuned: tuple[tuple[str, StrategyConfig], ...] = ()

    def act(self, observation: Observation) -> torch.Tensor:
        """The deterministic action (N, J)."""
        with torch.no_grad():
            return self.actor(observation.actor, observation.depth)

    def to(self, device: torch.device) -> Policy:
        """The same on a device."""
        self.actor.to(device)
        self.critic.to(device)
        return self


def new(layout: ObservationLayout, networks: NetworkConfig, robot: str, seed: int) -> Policy:
    """A policy with random weights, the same for the same seed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Policy(Actor(layout, networks), Critic(layout, networks), layout, networks, robot)


def fine_tune(base: Policy, strategy: str, config: StrategyConfig, seed: int = 0) -> Policy:
    """The base made ready for fine-tuning by a strategy: the same function, other parameters to train.

    The critic goes on learning whole, its normaliser stays as the base's. `base` is used up: its modules become part
    of the result.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        actor = STRATEGIES[strategy](base.actor, config)
    base.critic.normaliser.frozen = True
    return Policy(actor, base.critic, base.layout, base.networks, base.robot, (*base.tuned, (strategy, config)))


def check_layout(found: ObservationLayout, expected: ObservationLayout, file: str | None = None) -> None:
    """Refuse a policy that was trained on other observations or another robot; the message names what differs.

    Args:
        found: the policy's.
        expected: the environment's.
        file: where the policy came from.
    """
    for part, old, new_ in (
        ("actions (joints)", found.actions, expected.actions),
        ("actor observation", found.actor, expected.actor),
        ("critic observation", found.critic, expected.critic),
        ("depth stack (frames, height, width)", found.depth or (), expected.depth or ()),
        ("depth stride", (found.depth_stride,), (expected.depth_stride,)),
    ):
        if tuple(old) == tuple(new_):
            continue
        index = next((i for i, (a, b) in enumerate(zip(old, new_, strict=False)) if a != b), min(len(old), len(new_)))
        raise TrainerError(
            f"the policy does not fit this robot or task: its {part} differs at entry {index}",
            file=file,
            expected=_entry(new_, index),
            found=_entry(old, index),
            hint="give the --task-file of its training, or pretrain a policy for this task (realsim pretrain)",
        )


def _entry(entries: tuple[object, ...], index: int) -> str:
    if index >= len(entries):
        return f"nothing ({len(entries)} entries)"
    entry = entries[index]
    if isinstance(entry, tuple):
        return f"{entry[0]} of width {entry[1]}"
    return str(entry)
