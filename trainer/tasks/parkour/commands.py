"""The velocity command: towards the goal, clipped, so that running ahead or turning away at the start does not pay."""

import torch
from torch import Tensor

from trainer.physics import State
from trainer.tasks.parkour.config import CommandConfig
from trainer.tasks.parkour.draw import rand, uniform
from trainer.tasks.parkour.signals import Command
from trainer.tasks.rotations import heading_of, into_heading


class GoalCommand:
    """The goal of each world and the speed at which it is to be approached."""

    def __init__(self, config: CommandConfig, worlds: int, device: torch.device) -> None:
        self.config = config
        self.goal = torch.zeros(worlds, 2, device=device)
        self.limit = torch.zeros(worlds, device=device)

    def reset(self, ids: Tensor, goals: Tensor, generator: torch.Generator) -> None:
        """New goals (K, 2) for worlds (K,); draws their speeds."""
        self.goal[ids] = goals
        speed = uniform(self.config.speed, (len(ids),), generator)
        stand = rand((len(ids),), generator) < self.config.standing
        self.limit[ids] = torch.where(stand, torch.zeros_like(speed), speed)

    def __call__(self, state: State) -> Command:
        """The command in the present state (paper, sec. III-B: goal vector clipped to a maximum)."""
        away = self.goal - state.base_pos[:, :2]
        distance = away.norm(dim=-1)
        seen = into_heading(heading_of(state.base_quat), away)
        speed = torch.minimum(self.config.gain * distance, self.limit)
        velocity = seen * (speed / distance.clamp_min(1e-6))[:, None]
        error = torch.atan2(seen[:, 1], seen[:, 0])
        # Close to the goal its direction means nothing: the turning command fades with the speed command.
        fade = speed / self.limit.clamp_min(1e-6)
        most = self.config.yaw_rate
        yaw_rate = fade * (self.config.heading_gain * error).clamp(-most, most)
        return Command(velocity, yaw_rate, distance, self.limit.clone() if self.config.constant else speed)
