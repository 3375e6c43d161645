"""Terminations of episodes: one function per failure; `CAUSES` names and orders them."""

from collections.abc import Callable
from dataclasses import dataclass
from math import cos

import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import TerminationConfig
from trainer.tasks.parkour.signals import Signals


@dataclass
class Clocks:
    """Times of each world, seconds (N,), and what its terrain allows."""

    at_start: Tensor
    """Since when it has been within reach of where it was put."""
    on_goal: Tensor
    """Since when it has stood on the goal platform."""
    ground_fails: Tensor
    """(N,) bool."""
    floor_z: Tensor
    """(N,) m, where the ground collides."""
    moving: Tensor
    """(N,) bool, told to go."""


def diverged(s: Signals, clocks: Clocks, body: Body, c: TerminationConfig) -> Tensor:
    """The simulation broke; not the policy's fault, and counted apart."""
    return s.state.diverged


def ground(s: Signals, clocks: Clocks, body: Body, c: TerminationConfig) -> Tensor:
    """Any link touches the ground (paper, termination 2)."""
    return s.state.ground_contact & clocks.ground_fails


def tilt(s: Signals, clocks: Clocks, body: Body, c: TerminationConfig) -> Tensor:
    """Torso or base leans too far (paper, termination 3)."""
    highest = -cos(c.tilt)
    return (s.torso_gravity[:, 2] > highest) | (s.gravity[:, 2] > highest)


def collapsed(s: Signals, clocks: Clocks, body: Body, c: TerminationConfig) -> Tensor:
    """The base has sunk to its feet, on ground that may be touched (elsewhere touching it is the failure)."""
    support = torch.maximum(s.footholds.terrain_z.amax((-1, -2)), clocks.floor_z)
    height = s.state.base_pos[:, 2] - support
    return (height < c.collapsed * body.standing_height) & ~clocks.ground_fails


def stuck(s: Signals, clocks: Clocks, body: Body, c: TerminationConfig) -> Tensor:
    """Too long at the start (paper, termination 1)."""
    return (clocks.at_start > c.stuck_seconds) & clocks.moving


CAUSES: dict[str, Callable[[Signals, Clocks, Body, TerminationConfig], Tensor]] = {
    "diverged": diverged,
    "ground": ground,
    "tilt": tilt,
    "collapsed": collapsed,
    "stuck": stuck,
}
"""Failures; where several apply the first is named."""

OUTCOMES = ("running", *CAUSES, "timeout", "success")
"""State of an episode: code -> name. The last two end it without failure."""
RUNNING, DIVERGED, TIMEOUT, SUCCESS = 0, 1, len(OUTCOMES) - 2, len(OUTCOMES) - 1


def judge(s: Signals, clocks: Clocks, age: Tensor, max_steps: int, body: Body, c: TerminationConfig) -> Tensor:
    """(N,) outcome code of each world at this step."""
    done = torch.stack([f(s, clocks, body, c) for f in CAUSES.values()], -1)
    failure = done.float().argmax(-1) + 1
    # Filled in, not chosen by `where`: that copies its numbers from the host, and waits.
    code = torch.full_like(age, RUNNING).masked_fill(age >= max_steps, TIMEOUT)
    code = code.masked_fill(clocks.on_goal > c.goal_seconds, SUCCESS)
    return torch.where(done.any(-1), failure, code)
