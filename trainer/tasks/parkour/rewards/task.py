"""Task reward: go to the goal at the wanted speed, facing it; stay alive (paper, appendix, first group)."""

from __future__ import annotations

import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.signals import Signals

SLOW, WALKING = 0.15, 0.3
"""m/s: who is told to go faster than the second and is slower than the first waits."""
_JOINTS_OF_G1 = 29
"""The slack of 4 rad in `stand_still` is for this many joints."""


def linear_velocity(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """exp(-|v*_xy - v_xy|^2 / sigma^2), heading frame."""
    error = (s.command.velocity - s.heading_vel).square().sum(-1)
    return torch.exp(-error / c.velocity_sigma**2)


def angular_velocity(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """exp(-(w*_z - w_z)^2 / sigma^2)."""
    return torch.exp(-(s.command.yaw_rate - s.ang_vel[:, 2]).square() / c.velocity_sigma**2)


def heading_error(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|w*_z|: the wanted yaw rate is the heading error, clipped."""
    return s.command.yaw_rate.abs()


def dont_wait(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """0 to 3: slower than 0.15 m/s, backward, and faster backward than 0.15 m/s, while told to go."""
    v = s.heading_vel[:, 0]
    slow = (v < SLOW).float() + (v < 0.0).float() + (v < -SLOW).float()
    return (s.command.velocity[:, 0] > WALKING) * slow


def alive(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """1."""
    return torch.ones_like(s.command.yaw_rate)


def stand_still(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|q - q_default|_1 - 4, while told to stand; the slack of 4 rad shrinks with the number of joints."""
    moved = (s.state.joint_pos - body.default).abs().sum(-1)
    slack = 4.0 * len(body.default) / _JOINTS_OF_G1
    return (moved - slack) * (s.command.speed < 0.15) * (s.command.yaw_rate.abs() < 0.15)
