"""Runs that repeat a command, whose differences are no gap; and which runs are fitted, which held out."""

from collections.abc import Sequence

import numpy as np

from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.case.case import Case, Run
from realsim.gap.config import DiagnoseConfig

MOST_FITTED, LEAST_FITTED = 6, 3
"""Runs that carry the sensitivities, and how many of them do where all would take longer than WORK. Budget."""
ENOUGH = 7
"""Different runs from which on a whole regime is held out beside the last runs."""
FAINT, STANDS_ALONE = 0.1, 5.0
"""Motion that is commanded in the run held out: at least this part of the others' median, at most this many times
their largest. Not tuned."""
APART = 1.5
"""A run is of another regime if its speed differs from the usual by this many spreads over runs."""


def split_runs(case: Case, config: DiagnoseConfig) -> tuple[list[int], list[int]]:
    """(runs for fitting, runs that nothing is fitted to). Only commands are looked at: no measurement decides.

    A replicate of a fitted run is no test, so it is not held out. Where every run has replicates, whole groups of them
    take the place of runs; if all repeat one command, none is held out. Nor is one of two runs.

    The last run is held out, unless it is commanded to move hardly at all, and so checks nothing, or by far the most,
    so that without it there is nothing to fit: then the run with a middling amount of motion is.

    Where there are enough runs, the one whose regime (speed, posture) is farthest from the others' is held out too:
    a cause must hold beyond the motions that it was found in. Of many runs only some carry the sensitivities: the most
    lively ones first, repetitions last; the others are held out too. Runs that were recorded to tell causes apart
    (`Case.added`) are always fitted.
    """
    count = len(case.runs)
    added = {i for i, run in enumerate(case.runs) if run.name in case.added}
    twins = [g for g in replicates(case) if not added & set(g)]
    single = [i for i in range(count) if i not in added and not any(i in g for g in twins)]
    groups = [[i] for i in single] or sorted(twins, key=max)
    spare = count > config.holdout + 1 and (bool(single) or len(twins) > config.holdout)
    kept = groups[-config.holdout :] if config.holdout and spare else []
    motion = [float(np.abs(np.diff(run.command, axis=0)).sum()) for run in case.runs]
    if len(kept) == 1 and not _ordinary(motion, kept[0]):
        kept = [sorted(groups, key=lambda g: np.mean([motion[i] for i in g]))[len(groups) // 2]]
    held = sorted(i for group in kept for i in group)
    if held and len(single) >= ENOUGH:
        held = sorted([*held, *_regime_apart(case, [i for i in single if i not in held])])
    fitted = [i for i in range(count) if i not in held]
    work = case.model.nv / case.model.opt.timestep * float(np.mean([run.duration for run in case.runs]))
    most = int(np.clip(figures.WORK / work, LEAST_FITTED, MOST_FITTED))
    if len(fitted) > most:
        repeated = {i for g in twins for i in g[1:]}
        order = sorted(fitted, key=lambda i: (i not in added, i in repeated, -motion[i]))
        fitted = sorted(order[:most])
        again = {i for g in twins if set(g) & set(fitted) for i in g}
        spared = set(order[most:]) - again - added
        held = sorted({*held, *spared}) if held else held
    return fitted, held


def _ordinary(motion: Sequence[float], runs: Sequence[int]) -> bool:
    """Whether these runs are commanded to move neither hardly at all nor far more than all others."""
    others = np.array([m for i, m in enumerate(motion) if i not in runs])
    own = float(np.mean([motion[i] for i in runs]))
    return bool(FAINT * np.median(others) <= own <= STANDS_ALONE * others.max())


def _regime_apart(case: Case, runs: list[int]) -> list[int]:
    """The run farthest from the others in speed and posture; none if none stands apart."""
    features = np.array([_regime(case.runs[i]) for i in runs])
    spread = features.std(axis=0) + 1e-9
    distance = np.abs((features - np.median(features, axis=0)) / spread).max(axis=1)
    best = int(np.argmax(distance))
    return [runs[best]] if distance[best] > APART else []


def _regime(run: Run) -> F64:
    """Log of the command's mean speed, and the mean posture."""
    speed = np.abs(np.diff(run.command, axis=0)).sum() / max(run.duration, 1e-9)
    return np.concatenate([[np.log(speed + 1e-6)], run.command.mean(axis=0)])


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
