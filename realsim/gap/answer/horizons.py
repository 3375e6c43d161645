"""What causes bring over short horizons: predictions from states of the log in all windows that no fit has seen.

A whole replay says little of a robot that swings up, flies or walks: it parts from the log whatever the model. From
states of the log, a second at most ahead, a right cause predicts better in nearly every window. Windows of a fitted run
are predicted by values that were fitted to the other runs.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from realsim.core.errors import GapError
from realsim.core.statistics import interval90, resampled
from realsim.core.types import F64
from realsim.gap import figures
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.check import Horizons
from realsim.gap.answer.leaveout import LeftOut
from realsim.gap.case.model.channels import Channel
from realsim.gap.case.motion import rate_gain
from realsim.gap.inference.causes.fitted import Fit, at, is_gap
from realsim.gap.inference.evidence.shooting import Shots, shoot
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Setting

SHORTEST = 0.09
"""Seconds: below, noise of the estimated states is most of an error."""
BLOCK = 4
"""Windows in a row that count as one in the bootstrap: they overlap."""
LEAST_WINDOWS = 12
"""Fewer say nothing of an interval."""


def over_horizons(screen: Screen, fit: Fit, left: LeftOut | None, held: Sequence[int], seed: int) -> Horizons | None:
    """None where the log has no whole states, or too few windows, or what is missing does not show over them."""
    simulator, comparison = screen.simulator, screen.comparison
    if not simulator.case.whole:
        return None
    before, after = list[F64](), list[F64]()
    for run, settings in _unseen(screen, fit, left, held):
        try:
            shots = [shoot(simulator, s, [run], fit.conditions.onsets) for s in ((), settings)]
        except GapError:
            continue
        for squares, shot in zip((before, after), shots, strict=True):
            noise, time = comparison.noise, comparison.case.runs[run].time
            squares.append(_squares(comparison.channels, noise.sensor, noise.detail, time, shot))
    return compared(before, after, seed)


def only_in_long_replays(kept: Arrays | None) -> bool | None:
    """Whether whole replays are lost and the nominal simulator's predictions over short horizons are no worse than
    noise in most windows of the check, as in a fall or a tumble: it parts from its log whatever the model.

    None where replays are lost, and too few windows say why.
    """
    if kept is None or not kept.runs:
        return False
    joints = [k for k, c in enumerate(kept.channels) if c.signal == "joint_pos"]
    errors = np.sqrt(np.nanmean(np.concatenate(kept.errors_before)[:, joints] ** 2, axis=0))
    if np.median(errors / np.nanstd(np.concatenate(kept.before)[:, joints], axis=0)) < figures.FOLLOWS:
        return False
    time = kept.case.runs[kept.runs[0]].time
    squares = _squares(kept.channels, kept.sensor, kept.detail, time, kept.shots[0])
    known = squares[np.isfinite(squares)]
    return None if len(known) < LEAST_WINDOWS else bool(np.median(known) < figures.GATE_MEDIAN)


def compared(before: Sequence[F64], after: Sequence[F64], seed: int) -> Horizons | None:
    """From (W,) mean squares of the same windows, an array a run; None of too few, or where there is no error."""
    rows = []
    for x, y in zip(before, after, strict=True):
        known = np.isfinite(x) & np.isfinite(y)
        edges = np.arange(0, known.sum(), BLOCK)
        if len(edges):
            rows.append(np.stack([np.add.reduceat(v[known], edges) for v in (x, y, np.ones(len(x)))], axis=1))
    if not rows or (total := (blocks := np.concatenate(rows)).sum(axis=0))[2] < LEAST_WINDOWS:
        return None
    mean = float(total[0] / total[2])
    if not is_gap(np.array([mean])):
        return None
    sums = resampled(blocks, 400, seed).sum(axis=1)
    low, high = interval90(1 - sums[:, 1] / sums[:, 0])
    return Horizons(int(total[2]), mean, float(1 - total[1] / total[0]), (float(low), float(high)))


def _unseen(
    screen: Screen, fit: Fit, left: LeftOut | None, held: Sequence[int]
) -> Iterator[tuple[int, Sequence[Setting]]]:
    """(run, the causes with values that were not fitted to it)."""
    for run in held:
        yield run, fit.settings()
    if left is not None and len(screen.runs) > 1:
        for run, values in zip(screen.runs, left.values, strict=True):
            yield run, [s for c in at(fit.causes, values) for s in c.settings()]


def _squares(channels: Sequence[Channel], sensor: F64, detail: F64, time: F64, shots: Shots) -> F64:
    """(W,) mean over horizons and signals, in units of the noise of samples (C,), slow details (C,) and speeds."""
    size = {(c.signal, c.label): k for k, c in enumerate(channels)}
    columns = [size[name] for name in shots.names]
    far = shots.seconds >= SHORTEST
    speed = sensor[columns] * rate_gain(time)
    noise = sensor[columns] ** 2 + detail[columns] ** 2 + (shots.seconds[far, None] * speed) ** 2
    ratios = shots.errors[:, far] ** 2 / noise
    count = np.isfinite(ratios).sum(axis=(1, 2))
    return np.where(count > 0, np.nansum(ratios, axis=(1, 2)) / np.maximum(count, 1), np.nan)
