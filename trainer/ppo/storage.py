"""The samples of one iteration, (steps, worlds, ...), and what PPO computes from them."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from trainer.tasks import Observation, ObservationLayout

Row = int | Tensor
"""Row of a buffer: a number, or a tensor (1,) on the device, which a CUDA graph can read."""


@dataclass
class Batch:
    """Samples of a minibatch; rows are samples."""

    observation: Observation
    action: Tensor
    mean: Tensor
    log_prob: Tensor
    value: Tensor
    returns: Tensor
    advantage: Tensor
    log_std: Tensor
    """(J,) of the policy that acted: the same in all samples."""


class Frames:
    """Depth frames, each kept once; stacks are gathered when they are requested.

    A stack of M frames repeats M - 1 of those of the stack a stride before it. Kept once, with the (M - 1) * stride
    frames that reach back before the iteration, 4096 worlds x 24 steps of eight 18 x 32 frames five steps apart are
    0.3 GB instead of 0.9. Frames are kept (and shown to the policy) in half precision on a GPU: 0.5 mm at 1 m.
    """

    def __init__(self, steps: int, worlds: int, layout: ObservationLayout, device: torch.device) -> None:
        assert layout.depth is not None
        self.count, height, width = layout.depth
        self.stride, self.steps, self.worlds = layout.depth_stride, steps, worlds
        self.dtype = torch.float16 if device.type == "cuda" else torch.float32
        self.whole = self.stride == 0 and self.count > 1  # the layout does not say how stacks overlap
        self.past = 0 if self.whole else (self.count - 1) * max(self.stride, 1)
        shape = (self.count, height, width) if self.whole else (height, width)
        self.frames = torch.zeros(self.past + steps, worlds, *shape, dtype=self.dtype, device=device)
        self.first = torch.zeros(worlds, dtype=torch.long, device=device)  # row of the running episode's first frame
        self.firsts = torch.zeros(steps, worlds, dtype=torch.long, device=device)
        self.back = torch.arange(self.count, device=device) * self.stride

    def restart(self) -> None:
        """All worlds begin anew at the next step."""
        self.first.fill_(self.past)

    def add(self, step: Row, stack: Tensor) -> None:
        """Keep what is new in the stacks (N, M, H, W) of this step."""
        self.frames[self.past + step] = (stack if self.whole else stack[:, 0]).to(self.dtype)
        self.firsts[step] = self.first

    def ended(self, step: Row, done: Tensor) -> None:
        """Worlds (N,) bool that begin a new episode after this step."""
        self.first.mul_(~done).add_(done * (self.past + step + 1))

    def carry(self) -> None:
        """Make room for the next iteration; keep the frames that its stacks reach back to."""
        if self.past:
            self.frames[: self.past] = self.frames[self.steps :].clone()
        self.first -= self.steps

    def gather(self, samples: Tensor) -> Tensor:
        """(B, M, H, W) stacks of samples (B,) = step * worlds + world."""
        step, world = samples // self.worlds, samples % self.worlds
        if self.whole:
            return self.frames[step, world]
        rows = (self.past + step)[:, None] - self.back
        rows = torch.maximum(rows, self.firsts[step, world][:, None]).clamp(min=0)
        return self.frames[rows, world[:, None]]


class Rollout:
    """Fixed buffers for `steps` policy steps of `worlds` worlds."""

    def __init__(self, steps: int, worlds: int, layout: ObservationLayout, device: torch.device) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros(steps, worlds, *shape, device=device)

        actions = len(layout.actions)
        self.steps, self.worlds, self.device = steps, worlds, device
        self.actor, self.critic = zeros(layout.actor_width), zeros(layout.critic_width)
        self.action, self.mean = zeros(actions), zeros(actions)
        self.log_prob, self.value, self.reward = zeros(), zeros(), zeros()
        self.done = zeros().bool()
        self.returns, self.advantage = zeros(), zeros()
        self.log_std = torch.zeros(actions, device=device)
        self.frames = Frames(steps, worlds, layout, device) if layout.depth is not None else None

    def restart(self) -> None:
        """The environment has been reset."""
        if self.frames is not None:
            self.frames.restart()

    def see(self, step: Row, observation: Observation) -> Observation:
        """Keep an observation before the environment overwrites it; gives it as it will be seen in the update."""
        self.actor[step], self.critic[step] = observation.actor, observation.critic
        depth = observation.depth
        if self.frames is not None and depth is not None:
            self.frames.add(step, depth)
            depth = depth.to(self.frames.dtype)
        return Observation(observation.actor, observation.critic, depth)

    def add(
        self, step: Row, action: Tensor, mean: Tensor, log_prob: Tensor, value: Tensor, reward: Tensor, done: Tensor
    ) -> None:
        """Keep what was done at this step and what came of it: (N, J), (N, J), (N,), (N,), (N,), (N,) bool."""
        self.action[step], self.mean[step] = action, mean
        self.log_prob[step], self.value[step] = log_prob, value
        self.reward[step], self.done[step] = reward, done
        if self.frames is not None:
            self.frames.ended(step, done)

    def finish(self, last_value: Tensor, gamma: float, lam: float) -> None:
        """Compute returns and advantages; `last_value` (N,) is the value of the observation after the last step."""
        self.advantage.copy_(advantages(self.reward, self.value, self.done, last_value, gamma, lam))
        torch.add(self.advantage, self.value, out=self.returns)

    def carry(self) -> None:
        """The samples have been used: ready for the next iteration."""
        if self.frames is not None:
            self.frames.carry()

    def batches(self, count: int, generator: torch.Generator) -> Iterator[Batch]:
        """All samples once, shuffled, in `count` minibatches of the same size (a remainder is left out)."""
        total = self.steps * self.worlds
        order = torch.randperm(total, generator=generator, device=self.device)
        for samples in order[: total // count * count].view(count, -1):
            yield self.batch(samples)

    def batch(self, samples: Tensor) -> Batch:
        """The given samples (B,) = step * worlds + world."""

        def pick(x: Tensor) -> Tensor:
            return x.flatten(0, 1)[samples]

        depth = None if self.frames is None else self.frames.gather(samples)
        return Batch(
            Observation(pick(self.actor), pick(self.critic), depth),
            action=pick(self.action),
            mean=pick(self.mean),
            log_prob=pick(self.log_prob),
            value=pick(self.value),
            returns=pick(self.returns),
            advantage=pick(self.advantage),
            log_std=self.log_std,
        )


def advantages(reward: Tensor, value: Tensor, done: Tensor, last_value: Tensor, gamma: float, lam: float) -> Tensor:
    """Generalised advantage estimate (Schulman et al. 2016, equation 16), (T, N).

    Args:
        reward: (T, N); where an episode ran out of time, the discounted value of its true last observation is in it.
        value: (T, N) of the observations that were acted on.
        done: (T, N) bool, the episode ended with this step; nothing is carried over it.
        last_value: (N,) of the observation after the last step.
    """
    result = torch.empty_like(reward)
    running, following = torch.zeros_like(last_value), last_value
    for step in reversed(range(len(reward))):
        going = (~done[step]).float() * gamma
        running = reward[step] + going * following - value[step] + going * lam * running
        result[step], following = running, value[step]
    return result
