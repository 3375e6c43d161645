"""Figures that the report draws over time, from the arrays that a diagnosis keeps; nothing is simulated."""

from collections import Counter

import numpy as np

from realsim.core.types import F64
from realsim.gap.answer.arrays import Arrays


def horizons(kept: Arrays | None, signal: str = "joint_pos") -> list[tuple[str, float, float | None]]:
    """(horizon, before, after): error of predictions over each horizon, in units of a sample's noise floor."""
    if kept is None or signal not in kept.shots[0].signals():
        return []
    columns = [i for i, c in enumerate(kept.channels) if c.signal == signal]
    floor = float(np.sqrt(np.mean(kept.sensor[columns] ** 2 + kept.detail[columns] ** 2)))
    rms = [s.rms(signal) / floor for s in kept.shots]
    return [
        (label, float(rms[0][i]), float(rms[1][i]) if len(rms) > 1 else None)
        for i, label in enumerate(kept.shots[0].labels)
        if np.isfinite([r[i] for r in rms]).all()
    ]


def worst_windows(kept: Arrays, seconds: float = 1.5, count: int = 4) -> list[tuple[int, int, float, float]]:
    """(position in `runs`, channel, start, end): where the nominal simulator is farthest off, in units of the floor.

    Signals and channels take turns, so that four windows show four things where there are as many.
    """
    scored: list[tuple[float, int, int, float]] = []
    for k, error in enumerate(kept.errors_before):
        ratio = np.nan_to_num(error**2 / kept.floors[kept.runs[k]])
        width = min(max(int(seconds / kept.bin_seconds), 1), len(ratio))
        # Windows side by side, so that two of one channel never show the same.
        for first in range(0, len(ratio) - width + 1, width):
            start = float(kept.times[kept.runs[k]][first])
            scored += [(float(v), k, c, start) for c, v in enumerate(ratio[first : first + width].mean(axis=0))]
    chosen: list[tuple[float, int, int, float]] = []
    while scored and len(chosen) < count:
        of_channel = Counter(c for _, _, c, _ in chosen)
        of_signal = Counter(kept.channels[c].signal for _, _, c, _ in chosen)
        best = min(scored, key=lambda w: (of_channel[w[2]], of_signal[kept.channels[w[2]].signal], -w[0]))
        scored.remove(best)
        chosen.append(best)
    return [(k, c, start, start + seconds) for _, k, c, start in chosen]


def place_shares(kept: Arrays) -> tuple[list[tuple[str, str]], F64]:
    """(kind, name) of each row and (R, phases) shares: one row a joint (all its signals), one a signal of the base."""
    rows: dict[tuple[str, str], F64] = {}
    for channel, row in zip(kept.channels, kept.shares, strict=True):
        key = ("joint", channel.label) if channel.signal.startswith("joint") else ("signal", channel.signal)
        rows[key] = rows.get(key, np.zeros(kept.shares.shape[1])) + row
    return list(rows), np.array(list(rows.values()))
