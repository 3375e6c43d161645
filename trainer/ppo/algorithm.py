"""Clipped PPO (Schulman et al. 2017) from built parts: a policy, a critic, an optimiser, a rollout."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from trainer.ppo import gaussian
from trainer.ppo.config import PPOConfig
from trainer.ppo.distributed import all_mean, all_sum, average_gradients
from trainer.ppo.networks import Critic
from trainer.ppo.storage import Batch, Rollout
from trainer.tasks import Observation

Augment = Callable[[Batch], Batch]
"""Further samples made from those of a batch, such as their mirror images; the same number."""


@dataclass
class Action:
    """What the policy does at a step."""

    sample: Tensor
    mean: Tensor
    log_prob: Tensor


class PPO:
    """Acts, and improves the policy from what came of it.

    Args:
        policy: mean action of (vector, depth), with `log_std`; only parameters that require a gradient are changed.
        critic: value of an observation.
        config: see `PPOConfig`.
        augment: adds samples to every minibatch.
        tuned: the policy is a base to be fine-tuned: it begins with a smaller learning rate (`PPOConfig.first_rate`).

    Nothing here waits for the GPU: the learning rate lives on the device, statistics are read once an iteration.
    """

    def __init__(
        self,
        policy: nn.Module,
        critic: Critic,
        config: PPOConfig,
        *,
        augment: Augment | None = None,
        tuned: bool = False,
    ) -> None:
        self.policy, self.critic, self.config, self.tuned = policy, critic, config, tuned
        self.augment = augment
        self.limit_noise(0)
        self.actor_parameters = [p for p in policy.parameters() if p.requires_grad]
        self.critic_parameters = list(critic.parameters())
        device = self.critic_parameters[0].device
        self.learning_rate = torch.tensor(config.first_rate(tuned), device=device)
        groups: list[dict[str, Any]] = [
            {"params": self.actor_parameters, "lr": self.learning_rate},
            {"params": self.critic_parameters, "lr": config.critic_rate or self.learning_rate},
        ]
        self.optimiser = torch.optim.Adam(groups, fused=True)

    @property
    def log_std(self) -> Tensor:
        return gaussian.bounded(self.policy.log_std, self.std_limit)  # type: ignore[arg-type]

    def limit_noise(self, iteration: int) -> None:
        """Bound the exploration noise as the schedule has it for this iteration."""
        self.std_limit = self.config.std_limit(iteration, self.tuned)
        gaussian.keep_within(self.policy.get_parameter("log_std"), self.std_limit)

    @torch.no_grad()
    def act(self, observation: Observation, generator: torch.Generator) -> Action:
        """Sample actions (N, J)."""
        # The parameter is within its bounds (`keep_within`), which change; a CUDA graph keeps those of its capture.
        mean, log_std = self.policy(observation.actor, observation.depth), self.policy.get_parameter("log_std")
        action = gaussian.sample(mean, log_std, generator)
        return Action(action, mean, gaussian.log_prob(action, mean, log_std))

    @torch.no_grad()
    def finish(self, rollout: Rollout, last: Observation) -> None:
        """Returns and advantages of a full rollout; advantages are normalised over all samples of all ranks."""
        rollout.log_std.copy_(self.log_std)
        rollout.finish(self.critic.of(last), self.config.gamma, self.config.lam)
        a = rollout.advantage
        mean = all_mean(a.mean())
        n = all_sum(torch.tensor(float(a.numel()), device=a.device))
        variance = all_sum((a - mean).square().sum()) / (n - 1)
        a.sub_(mean).div_(variance.sqrt() + 1e-8)

    def update(self, rollout: Rollout, generator: torch.Generator) -> dict[str, Tensor]:
        """All epochs over a finished rollout; the mean of every loss, on the device."""
        totals: dict[str, Tensor] = {}
        c = self.config
        for _ in range(c.epochs):
            for batch in rollout.batches(c.minibatches, generator):
                losses = self._gradients(batch)
                average_gradients([*self.actor_parameters, *self.critic_parameters])
                losses["gradient/policy"] = nn.utils.clip_grad_norm_(self.actor_parameters, c.max_gradient)
                losses["gradient/critic"] = nn.utils.clip_grad_norm_(self.critic_parameters, c.max_gradient)
                self.optimiser.step()
                gaussian.keep_within(self.policy.get_parameter("log_std"), self.std_limit)
                for name, value in losses.items():
                    totals[name] = totals.get(name, 0) + value / (c.epochs * c.minibatches)
        # After the update, not before: the policy must be measured against what it was when it acted.
        for network, seen in ((self.policy, rollout.actor), (self.critic, rollout.critic)):
            network.normaliser.update(seen)  # type: ignore[union-attr,operator]
        return {
            **totals,
            "learning_rate": self.learning_rate.clone(),
            "std": self.log_std.detach().exp().mean(),
            "std_limit": torch.tensor(self.std_limit),
            "explained_variance": explained_variance(rollout.value, rollout.returns),
        }

    def _gradients(self, batch: Batch) -> dict[str, Tensor]:
        c = self.config
        own = len(batch.action)  # samples that were acted on; an augmentation adds others after them
        batch = batch if self.augment is None else self.augment(batch)
        mean = self.policy(batch.observation.actor, batch.observation.depth)
        value, log_std = self.critic.of(batch.observation), self.log_std
        kl = gaussian.divergence(batch.mean[:own], batch.log_std, mean[:own].detach(), log_std.detach())
        kl = all_mean(kl.mean())
        if c.schedule == "adaptive":
            self._adapt(kl)
        ratio = torch.exp(gaussian.log_prob(batch.action, mean, log_std) - batch.log_prob)
        policy_loss = surrogate(ratio, batch.advantage, c.clip)
        value_loss = clipped_value_loss(value, batch.value, batch.returns, c.clip)
        entropy = gaussian.entropy(log_std)
        loss = policy_loss + c.value_weight * value_loss - c.entropy_weight * entropy
        clipped = ((ratio.detach() - 1).abs() > c.clip).float().mean()
        losses = {
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": kl,
            "clip_fraction": clipped,
        }
        self.optimiser.zero_grad()
        loss.backward()
        return {name: value.detach() for name, value in losses.items()}

    def _adapt(self, kl: Tensor) -> None:
        """Learning rate after the KL divergence of the last gradient step, without waiting for the device."""
        low, high = self.config.learning_rates
        rate, desired = self.learning_rate, self.config.desired_kl
        slower = torch.where(kl > 2 * desired, (rate / 1.5).clamp(min=low), rate)
        faster = (kl < desired / 2) & (kl > 0)
        rate.copy_(torch.where(faster, (rate * 1.5).clamp(max=high), slower))

    def state_dict(self) -> dict[str, object]:
        """The optimiser with its learning rate, and the rate that was requested."""
        return {
            "adam": self.optimiser.state_dict(),
            "learning_rate": float(self.learning_rate),
            "asked_rate": self.config.learning_rate,
        }

    def forget(self) -> None:
        """Begin anew with the first learning rate and no momentum, as for a policy that was put in its place."""
        self.optimiser.state.clear()
        self.learning_rate.fill_(self.config.first_rate(self.tuned))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """The inverse. If a different learning rate is requested, it replaces the saved one."""
        self.optimiser.load_state_dict(state["adam"])
        requested = self.config.learning_rate
        # The same command again must go on exactly: the schedule may have moved the rate since.
        kept = requested is None or requested == state.get("asked_rate")
        self.learning_rate.copy_(torch.tensor(state["learning_rate"] if kept else requested))
        policy, critic = self.optimiser.param_groups
        policy["lr"] = self.learning_rate  # loading has put a copy there; the schedule moves ours
        critic["lr"] = self.config.critic_rate or self.learning_rate


def surrogate(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """The clipped surrogate objective, to be made small."""
    return torch.max(-advantage * ratio, -advantage * ratio.clamp(1 - clip, 1 + clip)).mean()


def clipped_value_loss(value: Tensor, old: Tensor, returns: Tensor, clip: float) -> Tensor:
    """Squared error of the value, whose change is clipped as the ratio's is."""
    near = old + (value - old).clamp(-clip, clip)
    return torch.max((value - returns).square(), (near - returns).square()).mean()


def explained_variance(value: Tensor, returns: Tensor) -> Tensor:
    """() share of the returns' variance that the critic foresaw; 1 is perfect, 0 no better than their mean."""
    return 1 - (returns - value).var() / returns.var().clamp_min(1e-8)


def bootstrap(reward: Tensor, final_value: Tensor, truncated: Tensor, gamma: float) -> Tensor:
    """Rewards (N,) where time that ran out is not taken for an end: the value of the true last observation is added.

    Rows of `final_value` that were not truncated may hold anything, not-a-number included.
    """
    return torch.where(truncated, reward + gamma * final_value, reward)
