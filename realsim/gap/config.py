"""Options of a diagnosis."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from realsim.core.limits import check_limits

SHORTEST_RUN = 0.1
"""Seconds of a run that must be left when it is cut: less does not show the motion of a servo."""


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
    time_limit: float = 10.0
    """Minutes: the search ends in time to answer by then, with the best so far, and the answer says so."""
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
        counts = dict.fromkeys(("max_causes", "threads", "max_runs", "bootstrap"), 1)
        sizes = dict.fromkeys(("unexplained_share", "holdout", "settle_seconds", "seed"), 0)
        check_limits(
            self,
            above={"bin_seconds": 0, "time_limit": 0},
            least={**counts, **sizes, "max_seconds": SHORTEST_RUN},
            most={"bin_seconds": 0.2, "unexplained_share": 1},
        )


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
        limits = {"above": {"max_speed": 0, "max_torque": 0}, "least": {"seconds": 2, "seed": 0}}
        check_limits(self, **limits, most={"seconds": 10})  # a diagnosis reads ten seconds of a run
