"""Options of a diagnosis."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

SHORTEST_RUN = 0.1
"""Seconds of a run that must be left when it is cut."""


@dataclass(frozen=True)
class DiagnoseConfig:
    effects: tuple[str, ...] = ()
    """Effects to consider; if empty, all of the library but friction_of_joints and position_torque."""
    max_causes: int = 3
    """At most this many causes are accepted."""
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Threads of the batch simulator; all cores by default."""
    max_runs: int = 12
    """At most this many runs are simulated, spread over the log; the rest are left out and named."""
    max_seconds: float | None = None
    """At most this many seconds of each run are simulated, from its start; by default 10, and 3 of a robot on legs."""
    bin_seconds: float = 0.02
    """Samples are averaged over bins of this width before comparison, seconds."""
    settle_seconds: float = 0.6
    """The simulator holds the first command for this long before a run that begins at rest."""
    holdout: int = 1
    """Runs that nothing is fitted to, for the check; none if the log has no more than one run beside them."""
    unexplained_share: float = 0.20
    """From this share of the gap left over, the verdict says that a part stays."""
    bootstrap: int = 400
    """Resamples for intervals."""
    seed: int = 0
    """Seed of everything random."""
    deviations: Path | None = None
    """JSON with standard deviations of everyday deviations that you know better than the library (docs/diagnose.md)."""
    report: bool = True
    """Write report.html beside diagnosis.json."""
    signals: bool = False
    """Write signals.mcap: measured and simulated signals for Foxglove, PlotJuggler or Rerun (extra `logs`)."""

    def __post_init__(self) -> None:
        if self.max_causes < 1 or self.threads < 1 or self.max_runs < 1:
            raise ValueError("max_causes, threads and max_runs must be at least 1")
        if not 0 < self.bin_seconds <= 0.2:
            raise ValueError("bin_seconds must lie in (0, 0.2]")
        if not 0 <= self.unexplained_share <= 1:
            raise ValueError("unexplained_share lies in 0..1")
        if self.holdout < 0 or not self.settle_seconds >= 0 or self.seed < 0:
            raise ValueError("holdout, settle_seconds and seed must not be negative")
        if self.max_seconds is not None and not self.max_seconds >= SHORTEST_RUN:
            raise ValueError(f"max_seconds must be at least {SHORTEST_RUN:g}: less does not show the motion of a servo")
        if self.bootstrap < 1:
            raise ValueError("bootstrap must be at least 1")


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
