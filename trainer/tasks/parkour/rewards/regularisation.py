"""Regularisation reward: feet off edges, calm joints, upright body (paper, appendix, second group)."""

from __future__ import annotations

import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.signals import Signals


def edge_penetration(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over sole points of |d| (|v| + eps), d the depth of the point in the tube around the nearest edge."""
    return (s.footholds.edge_depth * (s.footholds.speed + c.edge_epsilon)).sum((-1, -2))


def feet_air_time(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Shortest present phase of any foot while half of the feet (one of two) carry and the robot is told to go."""
    single = s.contact.sum(-1) == s.contact.shape[-1] // 2
    shortest = s.phase_time.min(-1).values.clamp_max(c.air_time_limit)
    return shortest * single * (s.command.speed > 0.15)


def feet_slide(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over feet in contact of |v_xy|."""
    return (s.state.foot_lin_vel[..., :2].norm(dim=-1) * s.contact).sum(-1)


def hip_deviation(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over hip joints of (q - q_default)^2."""
    return (s.state.joint_pos - body.default)[:, body.hips].square().sum(-1)


def base_tumbling(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|w_xy|^2 of the base, base axes."""
    return s.ang_vel[:, :2].square().sum(-1)


def joint_torque(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|tau|^2 of the legs."""
    return s.state.joint_torque[:, body.legs].square().sum(-1)


def joint_acceleration(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|q''|^2."""
    return s.state.joint_acc.square().sum(-1)


def joint_velocity(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|q'|^2."""
    return s.state.joint_vel.square().sum(-1)


def action_rate(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|a_t - a_(t-1)|^2."""
    return (s.action - s.last_action).square().sum(-1)


def torso_orientation(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|g_xy|^2 in the torso's axes ("flat orientation")."""
    return s.torso_gravity[:, :2].square().sum(-1)


def base_orientation(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|g_xy|^2 in the base's axes ("pelvis orientation")."""
    return s.gravity[:, :2].square().sum(-1)


def feet_orientation(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over feet in contact of |g_xy| in the foot's axes; nothing for feet that are points."""
    if body.soles.shape[1] == 1:
        return torch.zeros_like(s.command.yaw_rate)
    return (s.foot_gravity[..., :2].norm(dim=-1) * s.contact).sum(-1)


def feet_height(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over feet in contact and sole points of clip(h_foot - h_terrain - 0.035 m, 0, 0.3 m).

    0.035 m is the height of G1's foot body above its sole; here it is each robot's own.
    """
    lifted = s.state.foot_pos[..., 2:] - s.footholds.terrain_z - body.sole_depth[:, None]
    return (lifted.clamp(0.0, 0.3).sum(-1) * s.contact).sum(-1)


def feet_distance(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """exp(-max(0, 0.12 - |y_left - y_right|) / 0.05) - 1, heading frame; the mean over pairs of feet.

    Feet come in left-right pairs: (0, 1), (2, 3).
    """
    y = s.foot_offset[..., 1]
    close = (c.foot_distance - (y[:, 0::2] - y[:, 1::2]).abs()).clamp_min(0.0)
    return (torch.exp(-close / 0.05) - 1.0).mean(-1)


def energy(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """Sum over joints of (tau q' / k)^2, k the servo's stiffness."""
    return (s.state.joint_torque * s.state.joint_vel / body.kp).square().sum(-1)


def freeze_upper_body(s: Signals, body: Body, c: RewardConfig) -> Tensor:
    """|q - q_default|_1 of arms and waist."""
    return (s.state.joint_pos - body.default)[:, body.upper_body].abs().sum(-1)
