"""Safety reward: keep joints within what the motors can do (paper, appendix, third group)."""

from __future__ import annotations

import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.signals import Signals


def position_limits(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over joints of the angle beyond `soft_limits` of the range. Beyond the mechanical stops nothing can be."""
    middle, half = (body.upper + body.lower) / 2, (body.upper - body.lower) / 2
    return ((s.state.joint_pos - middle).abs() - c.soft_limits * half).clamp_min(0.0).sum(-1)


def velocity_limits(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over joints of the speed beyond 0.9 of the motor's."""
    return (s.state.joint_vel.abs() - 0.9 * body.velocity).clamp_min(0.0).sum(-1)


def torque_limits(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over joints of the squared torque beyond 0.8 of the servo's limit."""
    return (s.state.joint_torque.abs() - 0.8 * body.effort).clamp_min(0.0).square().sum(-1)


def undesired_contact(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """1 while anything but a foot touches the terrain."""
    return s.state.other_contact.float()


def floor_contact(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """1 while anything touches a raised floor (not in the paper; `FloorConfig`)."""
    return torch.zeros_like(s.command.yaw_rate) if s.floor_touched is None else s.floor_touched.float()
