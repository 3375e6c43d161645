"""Bins of a log in which the gap is larger than elsewhere: by motion, load, touchdown and place.

A bin stands out if the squared error above the floor is larger inside it than in the whole of its signal, beyond what
blocks of half a second scatter, with the share of false names held down (Benjamini and Hochberg, 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.statistics import resampled
from realsim.core.types import F64
from realsim.gap.case.model.channels import Channel, named_place
from realsim.gap.inference.likelihood.comparison import Comparison

BLOCK_SECONDS = 0.5
FEWEST_BLOCKS = 12
"""Short logs are cut into shorter blocks, so that there are at least as many."""
FALSE_SHARE = 0.1
"""Expected share of false names among those that are named."""
RESAMPLES = 400
RATIO = 1.3
"""A bin is worth naming from this multiple of its signal's mean error."""
LANDING = 0.15
"""Seconds before and after a touchdown that count as belonging to it."""
CELLS = 4
"""Cells of the ground along the longer side of the way."""


@dataclass(frozen=True)
class Bin:
    """Samples of one channel that have something in common."""

    channel: int
    by: str
    """`direction`, `speed`, `load`, `touchdown` or `place`."""
    name: str
    mask: tuple[Any, ...]
    """(B,) bool a run."""


def excesses(comparison: Comparison, residuals: Sequence[F64]) -> list[F64]:
    """(B, C) a run: squared error in units of the floor, less one; its mean is zero where there is no gap."""
    return [np.nan_to_num(r**2 / comparison.floor(i) - 1) for i, r in enumerate(residuals)]


def standouts(
    comparison: Comparison, residuals: Sequence[F64], tracks: Sequence[dict[str, F64]], seed: int = 0, most: int = 12
) -> list[dict[str, Any]]:
    """Bins that stand out, the largest share of the gap first: signal, joint or body, by, bin, ratio, share, p."""
    excess = excesses(comparison, residuals)
    total = sum(float(np.maximum(e, 0).sum()) for e in excess)
    bins = [b for c, channel in enumerate(comparison.channels) for b in _bins(comparison, c, channel, tracks)]
    tests = [_test(comparison, excess, b, seed) for b in bins]
    named = significant([p for p, _, _ in tests])
    found = []
    for b, (p, ratio, inside), yes in zip(bins, tests, named, strict=True):
        share = inside / max(total, 1e-12)
        if yes and ratio > RATIO and share > 0.01:
            channel = comparison.channels[b.channel]
            place = named_place(comparison.case, channel)
            entry = {"signal": channel.signal, **place, "by": b.by, "bin": b.name}
            found.append(entry | {"ratio": ratio, "share": share, "p": p})
    return sorted(found, key=lambda e: -float(e["share"]))[:most]


def significant(p: Sequence[float], false_share: float = FALSE_SHARE) -> list[bool]:
    """Which of many tests to believe so that at most this share of them is expected to be false."""
    if not len(p):
        return []
    from scipy.stats import false_discovery_control  # Benjamini and Hochberg 1995

    return [bool(adjusted <= false_share) for adjusted in false_discovery_control(np.asarray(p, float))]


def tail(
    comparison: Comparison, values: Sequence[F64], masks: Sequence[Any], against: float, seed: int = 0
) -> tuple[float, float]:
    """(p, mean): one-sided chance that a mean over masked samples exceeds `against` only by scatter between blocks.

    Args:
        values, masks: (B,) a run. The standard error is that of a bootstrap over blocks of half a second.
    """
    bins = sum(len(v) for v in values)
    width = max(min(int(BLOCK_SECONDS / comparison.config.bin_seconds), bins // FEWEST_BLOCKS), 1)
    sums, counts = [], []
    for v, m in zip(values, masks, strict=True):
        edges = np.arange(0, len(v), width)
        sums.append(np.add.reduceat(np.where(m, v, 0.0), edges))
        counts.append(np.add.reduceat(np.asarray(m, float), edges))
    s, n = np.concatenate(sums), np.concatenate(counts)
    filled = np.flatnonzero(n)
    if len(filled) < 4:
        return 1.0, float(s.sum() / max(n.sum(), 1))
    s, n = s[filled], n[filled]
    drawn = resampled(np.stack([s, n], axis=1), RESAMPLES, seed).sum(axis=1)
    means = drawn[:, 0] / drawn[:, 1]
    mean = float(s.sum() / n.sum())
    from scipy.special import ndtr

    return float(ndtr(-(mean - against) / max(float(means.std()), 1e-12))), mean


def _test(comparison: Comparison, excess: Sequence[F64], b: Bin, seed: int) -> tuple[float, float, float]:
    """(p, ratio to the whole channel, positive excess inside)."""
    values = [e[:, b.channel] for e in excess]
    whole = float(np.mean(np.concatenate(values)))
    if whole <= 0:
        return 1.0, 0.0, 0.0
    p, mean = tail(comparison, values, b.mask, whole, seed)
    inside = sum(float(np.maximum(v[m], 0).sum()) for v, m in zip(values, b.mask, strict=True))
    return p, mean / whole, inside


# ---------------------------------------------------------------- bins


def _bins(comparison: Comparison, c: int, channel: Channel, tracks: Sequence[dict[str, F64]]) -> list[Bin]:
    names = comparison.case.joint_names
    if channel.label in names:
        found = _by_motion(comparison, c, names.index(channel.label), tracks)
    else:
        found = []
    if comparison.case.floating:
        found += _by_touchdown(comparison, c) + _by_place(comparison, c)
    return [b for b in found if sum(int(np.sum(m)) for m in b.mask) >= 20]


def _by_motion(comparison: Comparison, c: int, joint: int, tracks: Sequence[dict[str, F64]]) -> list[Bin]:
    """Direction and size of the nominal velocity, and size of the nominal torque, of the channel's own joint."""
    velocity = [at_bins(comparison, i, t, t["vel"][:, joint]) for i, t in enumerate(tracks)]
    torque = [np.abs(at_bins(comparison, i, t, t["torque"][:, joint])) for i, t in enumerate(tracks)]
    peak = float(np.max(np.abs(np.concatenate(velocity)), initial=1e-9))
    top = float(np.max(np.concatenate(torque), initial=1e-9))
    rules = [
        ("direction", "forward", [v > 0.03 * peak for v in velocity]),
        ("direction", "backward", [v < -0.03 * peak for v in velocity]),
        ("speed", "at rest", [np.abs(v) <= 0.03 * peak for v in velocity]),
        ("speed", "slow", [(np.abs(v) > 0.03 * peak) & (np.abs(v) <= 0.3 * peak) for v in velocity]),
        ("speed", "fast", [np.abs(v) > 0.3 * peak for v in velocity]),
        ("load", "low", [t <= 0.25 * top for t in torque]),
        ("load", "high", [t > 0.6 * top for t in torque]),
    ]
    return [Bin(c, by, name, tuple(mask)) for by, name, mask in rules]


def at_bins(comparison: Comparison, run: int, track: dict[str, F64], values: F64) -> F64:
    """A quantity of the simulator's own grid at the bins of a run."""
    return np.nan_to_num(values[comparison.rows_at(run, track)])


def _by_touchdown(comparison: Comparison, c: int) -> list[Bin]:
    """Shortly before and after a foot comes down, where contacts were logged."""
    case = comparison.case
    if not case.contact_bodies or not all("contact" in r.signals for r in case.runs):
        return []
    before, after = [], []
    for i, run in enumerate(case.runs):
        on = np.nan_to_num(run.signals["contact"]) > 0.5
        landings = run.time[1:][(on[1:] & ~on[:-1]).any(axis=1)]
        late = comparison.times[i][:, None] - landings[None]
        before.append(((late < 0) & (late >= -LANDING)).any(axis=1))
        after.append(((late >= 0) & (late < LANDING)).any(axis=1))
    return [Bin(c, "touchdown", "just before", tuple(before)), Bin(c, "touchdown", "just after", tuple(after))]


def _by_place(comparison: Comparison, c: int) -> list[Bin]:
    """Squares of the ground that the base was over."""
    case = comparison.case
    if not case.has("base_pos"):
        return []
    ways = []
    for i, run in enumerate(case.runs):
        base = run.signals["base_pos"]
        finite = np.isfinite(base).all(axis=1)
        ways.append(
            np.stack([np.interp(comparison.times[i], run.time[finite], base[finite, a]) for a in (0, 1)], axis=1)
        )
    every = np.concatenate(ways)
    low, size = every.min(axis=0), float(np.ptp(every, axis=0).max()) / CELLS
    if size < 0.05:
        return []  # it stands; there are no places to compare
    found = []
    cells = [np.floor((w - low) / size).astype(int) for w in ways]
    for cell in np.unique(np.concatenate(cells), axis=0):
        x, y = low + cell * size
        name = f"x {x:.2f} to {x + size:.2f} m, y {y:.2f} to {y + size:.2f} m"
        found.append(Bin(c, "place", name, tuple((k == cell).all(axis=1) for k in cells)))
    return found
