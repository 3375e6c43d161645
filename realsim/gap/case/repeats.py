"""Runs that repeat a command: what they differ by is no gap, it is how repeatable the robot is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from realsim.gap.case.case import Case


def replicates(case: Case) -> list[list[int]]:
    """Groups of runs with the same command."""
    groups: list[list[int]] = []
    for i, run in enumerate(case.runs):
        for group in groups:
            other = case.runs[group[0]]
            n = min(len(run.command), len(other.command))
            same = np.allclose(run.command[:n], other.command[:n], atol=1e-6) and np.array_equal(
                run.on[:n], other.on[:n]
            )
            same = same and run.setup == other.setup
            if abs(len(run.command) - len(other.command)) <= 2 and same:
                group.append(i)
                break
        else:
            groups.append([i])
    return [g for g in groups if len(g) > 1]


def spread(case: Case, signal: str, only: Sequence[int] = ()) -> float | None:
    """Root mean square by which one run differs from what its repetitions share, over all columns; None without any.

    Args:
        only: a group of runs; all groups if empty.
    """
    found = []
    for group in [list(only)] if only else replicates(case):
        first = case.runs[group[0]]
        for i in group[1:]:
            run = case.runs[i]
            a, b = first.signals[signal], run.signals[signal]
            for column in range(a.shape[1]):
                good = np.isfinite(b[:, column])
                if good.sum() > 10:
                    other = np.interp(first.time, run.time[good], b[good, column], right=np.nan)
                    difference = a[:, column] - other
                    found.append(float(np.nanmean(difference**2)) / 2 if np.isfinite(difference).any() else np.nan)
    return float(np.sqrt(np.nanmean(found))) if np.isfinite(found).any() else None
