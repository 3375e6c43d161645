"""When something sudden happens: robot and simulator agree until a moment of its own in each run, and then do not.

A person who bumps into a robot does so at another time in every run, and in some not at all. What is the same is the
force, so that its time is read off each log like a contact, and only its size and length are fitted.
"""

from collections.abc import Sequence

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.runs import Run
from realsim.gap.inference.likelihood.comparison import Comparison

SMOOTH = 0.1
"""Seconds over which the squared error is averaged."""
CALM = 0.25
"""Quantile, over the runs, of their median errors: what is usual where nothing happens."""
LOUD, WITHIN = 50.0, 0.3
"""Multiple of the usual error that counts as something, and seconds in which it must have come up."""
UNUSUAL = 3.0
"""Multiple from which on it is coming up."""
MOVING = 0.3
"""Seconds of motion that must agree before: what begins with the motion is no push."""
STEEP = 3.0
"""Factor by which it must have come up in them, without falling in between."""
ALIKE = 0.1
"""Seconds between the quartiles of all runs' onsets below which they are a fixed time of every run."""


def find_onsets(
    comparison: Comparison, nominal: Sequence[F64], indices: Sequence[int] | None = None
) -> dict[str, float]:
    """Run -> seconds at which it suddenly leaves the simulator; empty unless that is what sets the gap apart.

    Some runs (two at least) must have such a moment, each its own or some none, and all others must stay quiet.

    Args:
        nominal: (T, C) a run, of the nominal simulator.
        indices: runs that are looked at; all if None.
    """
    chosen = range(len(comparison.case.runs)) if indices is None else indices
    runs = [comparison.case.runs[i] for i in chosen]
    levels = [_level(comparison, i, nominal[i]) for i in chosen]
    usual = max(float(np.quantile([np.median(level) for level in levels], CALM)), 1.0)
    found: dict[str, float] = {}
    for run, level, times in zip(runs, levels, [comparison.times[i] for i in chosen], strict=True):
        if level.max(initial=0.0) > LOUD * usual:
            at = _onset(level, times, usual)
            if at is None or at < _moves(run) + MOVING:
                return {}
            found[run.name] = at
    if len(found) < 2:
        return {}
    same = np.ptp(np.quantile(list(found.values()), [0.25, 0.75])) < ALIKE
    return {} if same and len(found) == len(runs) else found


def _moves(run: Run) -> float:
    """Seconds at which the command begins to change."""
    changed = np.abs(run.command - run.command[0]).max(axis=1) > 0.02 * np.ptp(run.command, axis=0).max()
    return float(run.time[int(np.argmax(changed))])


def _level(comparison: Comparison, run: int, nominal: F64) -> F64:
    """(B,) mean square in units of the floor, smoothed."""
    squares = comparison.residual(run, nominal) ** 2 / comparison.floor(run)
    good = np.isfinite(squares)
    mean = np.where(good, squares, 0.0).sum(axis=1) / np.maximum(good.sum(axis=1), 1)
    width = max(int(SMOOTH / comparison.config.bin_seconds), 1)
    return np.asarray(np.convolve(mean, np.ones(width) / width, mode="same"))


def _onset(level: F64, times: F64, usual: float) -> float | None:
    """Seconds at which the first loud error begins to come up, or None if it has been coming for long."""
    loud = int(np.argmax(level > LOUD * usual))
    began = loud
    while began > 0 and UNUSUAL * usual < level[began - 1] < level[began]:
        began -= 1
    steep = times[loud] - times[began] <= WITHIN and level[began] < level[loud] / STEEP
    return float(min(times[began] + SMOOTH / 2, times[loud])) if began and steep else None
