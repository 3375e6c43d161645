"""What can be set about trials of a policy; apart from their code, which needs torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from trainer.errors import check_fields


@dataclass(frozen=True)
class EvaluationConfig:
    """Number of trials, and what varies between them."""

    trials: int = 1000
    """On each terrain."""
    worlds: int = 250
    """Trials that run at once; part of what a seed means."""
    seed: int = 0
    """Of everything random in the trials."""
    randomise: bool = True
    """Whether friction, masses, gains, delays and sensor noise vary as in training; the starting pose always does."""
    pushes: bool = False
    """Whether the robot is pushed."""
    finish: Literal["reach", "stop"] = "reach"
    """When a trial succeeds. reach: at a constant speed, as `realsim deploy` and the paper, when base and feet are
    over the goal platform. stop: at a speed that falls with the distance to the goal, when the robot has stayed there
    for a second, as in training."""
    bin_m: float = 0.25
    """Metres a bin of the failures along the course."""

    def __post_init__(self) -> None:
        check_fields(self, above={"bin_m": 0}, least={"trials": 1, "worlds": 1})
