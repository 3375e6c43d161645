"""What can be set about the loop on the robot; apart from its code, which needs torch."""

from __future__ import annotations

from dataclasses import dataclass

from trainer.errors import check_fields


@dataclass(frozen=True)
class DeployConfig:
    """How the loop runs."""

    seconds: float = 10.0
    """Longest run."""
    speed: float = 0.8
    """Forward velocity command, m/s."""
    ramp: float = 0.0
    """Seconds over which the command rises from zero."""
    max_tilt: float = 1.0
    """Radians from upright at which the loop gives up."""
    max_step: float = 3.0
    """Radians that a joint target may be away from the joint: beyond, it is clipped."""
    max_late: int = 5
    """Steps in a row that may miss their time before the loop gives up."""
    realtime: bool = True
    """Keep to the clock; without, a simulated robot runs as fast as it can."""

    def __post_init__(self) -> None:
        check_fields(self, above={"seconds": 0, "max_tilt": 0, "max_step": 0}, least={"ramp": 0, "max_late": 1})
