"""The reward terms of the paper's appendix table. One function a term, one line a term here.

A term is `(Signals, Body, RewardConfig) -> (N,)`; the reward is the sum of weight * term, times the policy step.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.signals import Signals

Term = Callable[[Signals, Body, RewardConfig], Tensor]

_HERE = "trainer.tasks.parkour.rewards"

TERMS = Registry(
    "reward term",
    {
        "linear_velocity": f"{_HERE}.task:linear_velocity",
        "angular_velocity": f"{_HERE}.task:angular_velocity",
        "heading_error": f"{_HERE}.task:heading_error",
        "dont_wait": f"{_HERE}.task:dont_wait",
        "alive": f"{_HERE}.task:alive",
        "stand_still": f"{_HERE}.task:stand_still",
        "edge_penetration": f"{_HERE}.regularisation:edge_penetration",
        "feet_air_time": f"{_HERE}.regularisation:feet_air_time",
        "feet_slide": f"{_HERE}.regularisation:feet_slide",
        "hip_deviation": f"{_HERE}.regularisation:hip_deviation",
        "base_tumbling": f"{_HERE}.regularisation:base_tumbling",
        "joint_torque": f"{_HERE}.regularisation:joint_torque",
        "joint_acceleration": f"{_HERE}.regularisation:joint_acceleration",
        "joint_velocity": f"{_HERE}.regularisation:joint_velocity",
        "action_rate": f"{_HERE}.regularisation:action_rate",
        "torso_orientation": f"{_HERE}.regularisation:torso_orientation",
        "base_orientation": f"{_HERE}.regularisation:base_orientation",
        "feet_orientation": f"{_HERE}.regularisation:feet_orientation",
        "feet_height": f"{_HERE}.regularisation:feet_height",
        "feet_distance": f"{_HERE}.regularisation:feet_distance",
        "energy": f"{_HERE}.regularisation:energy",
        "freeze_upper_body": f"{_HERE}.regularisation:freeze_upper_body",
        "position_limits": f"{_HERE}.safety:position_limits",
        "velocity_limits": f"{_HERE}.safety:velocity_limits",
        "torque_limits": f"{_HERE}.safety:torque_limits",
        "undesired_contact": f"{_HERE}.safety:undesired_contact",
        "floor_contact": f"{_HERE}.safety:floor_contact",
    },
)

WEIGHTS = {
    "linear_velocity": 2.0,
    "angular_velocity": 0.1,
    "heading_error": -1.0,
    "dont_wait": -0.5,
    "alive": 3.0,
    "stand_still": -0.3,
    "edge_penetration": -1.0,
    "feet_air_time": 0.5,
    "feet_slide": -0.4,
    "hip_deviation": -0.5,
    "base_tumbling": -0.05,
    "joint_torque": -1.5e-7,
    "joint_acceleration": -1.25e-7,
    "joint_velocity": -1.0e-4,
    "action_rate": -0.005,
    "torso_orientation": -3.0,
    "base_orientation": -3.0,
    "feet_orientation": -0.4,
    "feet_height": -0.1,
    "feet_distance": 1.0,
    "energy": -5.0e-5,
    "freeze_upper_body": -0.004,
    "position_limits": -1.0,
    "velocity_limits": -1.0,
    "torque_limits": -0.01,
    "undesired_contact": -1.0,
    "floor_contact": -2.0,
}
"""The paper's weights (appendix, table of reward terms), but for the last, which only a raised floor has. The AMP term,
0.25, is the learner's."""


class Rewards:
    """The weighted sum, and the sum of every term since the last log."""

    def __init__(self, config: RewardConfig, body: Body, dt: float, device: torch.device) -> None:
        unknown = [name for name in config.weights if name not in TERMS]
        if unknown:
            raise UnknownNameError("reward term", unknown[0], TERMS)
        weights = WEIGHTS | config.weights
        self.names = [name for name in TERMS if weights[name] != 0.0]
        self._terms: list[Term] = [TERMS[name] for name in self.names]
        self._weights = torch.tensor([weights[name] * dt for name in self.names], device=device)
        self._config, self._body = config, body

    def scale(self, name: str, ratio: float) -> None:
        """Change the weight of a term, where it has one, from the next step on."""
        if name in self.names:
            self._weights[self.names.index(name)] *= ratio

    def __call__(self, signals: Signals) -> tuple[Tensor, Tensor]:
        """((N,) reward, (terms,) mean over worlds of weight * term * dt). Worlds that are not finite get 0."""
        terms = torch.stack([term(signals, self._body, self._config).float() for term in self._terms], -1)
        weighted = terms * self._weights
        weighted = torch.where(signals.state.diverged[:, None], torch.zeros_like(weighted), weighted)
        return weighted.sum(-1), weighted.mean(0)
