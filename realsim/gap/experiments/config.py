"""What can be set about the choice of an experiment."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ExciteConfig:
    excitations: tuple[str, ...] = ()
    """Excitations to choose from; if empty, all of the library."""
    seconds: float = 6.0
    """Of one run; an experiment has two."""
    max_speed: float | None = None
    """rad/s (m/s) that no joint may exceed; by default 1.5 times the highest speed of the log."""
    max_torque: float | None = None
    """N m (N) that no drive may exceed; by default 95 % of its limit in the model."""
    seed: int = 0
    """Of the phases of sines."""

    def __post_init__(self) -> None:
        if not 2.0 <= self.seconds <= 10.0:
            raise ValueError("seconds must lie in 2..10: a diagnosis reads ten seconds of a run")
        for name in ("max_speed", "max_torque"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be above 0")
        if self.seed < 0:
            raise ValueError("seed must not be negative")
