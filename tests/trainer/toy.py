"""A point mass on a line with a depth camera: small enough that PPO must learn it within seconds.

The goal lies left or right; only the depth image says where. Pushing the mass to it pays.
"""

from typing import Any

import torch
from torch import Tensor

from trainer.tasks import Observation, ObservationLayout, Step

LAYOUT = ObservationLayout(
    actor=(("position", 1), ("velocity", 1)),
    critic=(("position", 1), ("velocity", 1), ("goal", 1)),
    depth=(3, 6, 8),
    actions=("push", "idle"),
    depth_stride=2,
)


class PointMass:
    """`VecEnv` of point masses; `goal_sign` restricts where goals lie (a "terrain")."""

    warnings = ()
    graphs = False

    def __init__(self, worlds: int = 32, max_steps: int = 20, seed: int = 0, goal: float | None = None) -> None:
        self.num_worlds, self.num_actions = worlds, 2
        self.device = torch.device("cpu")
        self.layout = LAYOUT
        self.policy_dt, self.max_steps = 0.1, max_steps
        self.fixed = goal
        self.rng = torch.Generator().manual_seed(seed)
        self.level = torch.zeros(worlds)  # stands for a curriculum
        self.x = torch.zeros(worlds, 2)
        self.goal = torch.zeros(worlds)
        self.age = torch.zeros(worlds, dtype=torch.long)
        self.frames = torch.zeros(worlds, 5, 6, 8)

    def reset(self) -> Observation:
        self._begin(torch.ones(self.num_worlds, dtype=torch.bool))
        self.age = torch.randint(0, self.max_steps, (self.num_worlds,), generator=self.rng)
        return self._see()

    def step(self, actions: Tensor) -> Step:
        push = actions[:, 0].clamp(-2, 2)
        self.x[:, 1] = 0.7 * self.x[:, 1] + 0.5 * push
        self.x[:, 0] += self.policy_dt * self.x[:, 1]
        self.age += 1
        reward = self.policy_dt * torch.exp(-(self.x[:, 0] - self.goal).square() / 0.1)
        self.frames = torch.cat([self._frame()[:, None], self.frames[:, :-1]], 1)
        terminated = self.x[:, 0].abs() > 2
        truncated = (self.age >= self.max_steps) & ~terminated
        done = terminated | truncated
        final = self._see() if bool(done.any()) else None
        self.level += (done & ~terminated).float()
        self._begin(done)
        return Step(self._see(), reward, terminated, truncated, final, log={"level": float(self.level.mean())})

    def ease(self) -> None:
        self.level.zero_()

    def state_dict(self) -> dict[str, Any]:
        return {"rng": self.rng.get_state(), "level": self.level.clone()}

    def load_state_dict(self, state: dict[str, Any], seed: int | None = None) -> None:
        if seed is None:
            self.rng.set_state(state["rng"])
        else:
            self.rng.manual_seed(seed)
        self.level = state["level"].clone()

    def _begin(self, which: Tensor) -> None:
        n = self.num_worlds
        sign = (torch.randint(0, 2, (n,), generator=self.rng) * 2 - 1).float()
        goal = sign if self.fixed is None else torch.full((n,), self.fixed)
        start = 0.2 * torch.randn(n, 2, generator=self.rng)
        self.goal = torch.where(which, goal, self.goal)
        self.x = torch.where(which[:, None], start, self.x)
        self.age = torch.where(which, 0, self.age)
        self.frames = torch.where(which[:, None, None, None], self._frame()[:, None], self.frames)

    def _frame(self) -> Tensor:
        """(N, 6, 8): the half on the goal's side is near, and nearer when the mass is."""
        columns = torch.linspace(-1, 1, 8)
        near = (columns * self.goal[:, None] > 0).float() * (1 - 0.3 * (self.goal - self.x[:, 0]).abs()[:, None])
        return (1 - near.clamp(0, 1))[:, None, :].expand(-1, 6, -1)

    def _see(self) -> Observation:
        critic = torch.cat([self.x, self.goal[:, None]], 1)
        return Observation(self.x.clone(), critic, self.frames[:, ::2].clone())
