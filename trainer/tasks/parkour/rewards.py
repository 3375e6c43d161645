"""The reward terms of the paper's appendix table, one function a term.

A term is `(Signals, Body, RewardConfig) -> (N,)`; the reward is the sum of weight * term, times the policy step.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from realsim.core.errors import UnknownNameError
from realsim.core.registry import Registry
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import RewardConfig
from trainer.tasks.parkour.signals import Signals

Term = Callable[[Signals, Body, RewardConfig], Tensor]

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
}
"""The paper's weights (appendix, table of reward terms). The AMP term, 0.25, is the learner's."""

TERMS = Registry("reward term", {name: f"{__name__}:{name}" for name in WEIGHTS})

SLOW, WALKING = 0.15, 0.3
"""m/s: who is told to go faster than the second and is slower than the first waits."""
_JOINTS_OF_G1 = 29
"""The slack of 4 rad in `stand_still` is for this many joints."""


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


# ---------------------------------------------------------------- task: to the goal at the wanted speed; alive


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


# ---------------------------------------------------------------- regularisation: feet off edges, calm joints, upright


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


# ---------------------------------------------------------------- safety: within what the motors can do


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
