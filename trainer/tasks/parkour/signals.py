"""Signals for observations, rewards and terminations: computed once per step from the engine's state."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from trainer.physics import State
from trainer.tasks.parkour.body import Body
from trainer.tasks.rotations import heading_of, into_heading, rotate, rotate_back


@dataclass
class Command:
    """The goal as a velocity, for each world."""

    velocity: Tensor
    """(N, 2) m/s, towards the goal, in the base's heading frame (x where the base points, on the level)."""
    yaw_rate: Tensor
    """(N,) rad/s that would turn the base towards the goal."""
    distance: Tensor
    """(N,) m to the goal's centre."""
    speed_command: Tensor
    """(N,) m/s that the actor is told."""

    @property
    def speed(self) -> Tensor:
        """(N,) m/s."""
        return self.velocity.norm(dim=-1)

    def rows(self, ids: Tensor) -> Command:
        """Of worlds `ids` only."""
        return Command(self.velocity[ids], self.yaw_rate[ids], self.distance[ids], self.speed_command[ids])

    def observed(self, steered: bool = False) -> Tensor:
        """(N, 3) what the actor is told: straight ahead at this speed, no sideways and no turning command.

        On a real robot an operator gives it; nobody there knows where the goal is. Where somebody does, it is
        `steered`: velocity ahead and to the left, yaw rate.
        """
        if steered:
            return torch.cat([self.velocity, self.yaw_rate[:, None]], -1)
        zero = torch.zeros_like(self.yaw_rate)
        return torch.stack([self.speed_command, zero, zero], -1)


@dataclass
class Footholds:
    """Terrain around the soles. P points a foot."""

    terrain_z: Tensor
    """(N, F, P) m, height of the terrain (or the ground) under the point."""
    clearance: Tensor
    """(N, F, P) m from there up to the point; below zero inside."""
    edge_depth: Tensor
    """(N, F, P) m that the point lies inside the tube around the nearest edge."""
    speed: Tensor
    """(N, F, P) m/s of the point."""


@dataclass
class Signals:
    """One policy step of all worlds."""

    state: State
    gravity: Tensor
    """(N, 3) unit vector down, base axes."""
    torso_gravity: Tensor
    """(N, 3) the same in the torso's axes."""
    foot_gravity: Tensor
    """(N, F, 3) the same in each foot's axes."""
    lin_vel: Tensor
    """(N, 3) m/s of the base, base axes."""
    heading_vel: Tensor
    """(N, 2) m/s of the base on the level, heading frame."""
    ang_vel: Tensor
    """(N, 3) rad/s of the base, base axes."""
    foot_offset: Tensor
    """(N, F, 3) m from the base to the feet, heading frame."""
    contact: Tensor
    """(N, F) bool."""
    phase_time: Tensor
    """(N, F) s for which the foot has been in the air, or on something, without a change."""
    action: Tensor
    """(N, J)."""
    last_action: Tensor
    """(N, J) of the step before."""
    command: Command
    footholds: Footholds


def derive(
    state: State,
    command: Command,
    footholds: Footholds,
    contact: Tensor,
    phase_time: Tensor,
    action: Tensor,
    last_action: Tensor,
) -> Signals:
    """All signals of worlds whose rows these are; see the fields of `Signals` for shapes."""
    velocity, feet = heading_frame(state)
    return Signals(
        state=state,
        gravity=gravity_in(state.base_quat),
        torso_gravity=gravity_in(state.torso_quat),
        foot_gravity=gravity_in(state.foot_quat),
        lin_vel=rotate_back(state.base_quat, state.base_lin_vel),
        heading_vel=velocity,
        ang_vel=state.base_ang_vel,
        foot_offset=feet,
        contact=contact,
        phase_time=phase_time,
        action=action,
        last_action=last_action,
        command=command,
        footholds=footholds,
    )


def gravity_in(quat: Tensor) -> Tensor:
    """(..., 3) the unit vector down in the axes of bodies with these poses: less the third row of their rotation."""
    w, x, y, z = quat.unbind(-1)
    return torch.stack([2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1], -1)


def heading_frame(state: State) -> tuple[Tensor, Tensor]:
    """(velocity (N, 2), feet (N, F, 3)): how the base moves and where the feet are, seen by the base on the level."""
    ahead = heading_of(state.base_quat)
    feet = state.foot_pos - state.base_pos[:, None]
    level = into_heading(ahead[:, None], feet[..., :2])
    return into_heading(ahead, state.base_lin_vel[:, :2]), torch.cat([level, feet[..., 2:]], -1)


def sole_points(state: State, body: Body) -> tuple[Tensor, Tensor]:
    """((N, F, P, 3) positions, (N, F, P) speeds) of the points on the soles, terrain frame."""
    arm = rotate(state.foot_quat[:, :, None], body.soles)
    spin = torch.linalg.cross(state.foot_ang_vel[:, :, None].expand_as(arm), arm)
    return state.foot_pos[:, :, None] + arm, (state.foot_lin_vel[:, :, None] + spin).norm(dim=-1)


class PhaseClock:
    """For how long each foot has been in the air or on something."""

    def __init__(self, worlds: int, feet: int, dt: float, device: torch.device) -> None:
        self.contact = torch.ones(worlds, feet, dtype=torch.bool, device=device)
        self.time = torch.zeros(worlds, feet, device=device)
        self.dt = dt

    def advance(self, contact: Tensor) -> Tensor:
        """(N, F) seconds in the present phase, this step included."""
        self.time.mul_(contact == self.contact).add_(self.dt)
        self.contact.copy_(contact)
        return self.time

    def reset(self, ids: Tensor) -> None:
        self.time.index_fill_(0, ids, 0.0)
        self.contact.index_fill_(0, ids, True)
