"""Roles of columns that no name tells, by what robots do: velocities are slopes, and joints follow their commands."""

from __future__ import annotations

import numpy as np

from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.physics import travelled
from realsim.gap.recordings.signals import follows

SLOPE = 0.95
"""Correlation of what is travelled with an integral, from which one block of columns is the other's velocity."""
LEADS = 0.95
"""Correlation with which joints follow a block of columns that is their command."""
MOST = 4000
MOST_COLUMNS = 64


def leads(time: F64, asked: F64, done: F64) -> float:
    """How well joints (T, K) follow columns (T, K) some time later: the median correlation, 0 where it is not later."""
    found = []
    for k in range(done.shape[1]):
        if np.nanstd(asked[:, k]) < 1e-6 or np.nanstd(done[:, k]) < 1e-6:
            continue
        corr, lag, _, _ = follows(time[:MOST], asked[:MOST, k], done[:MOST, k])
        found.append(corr if lag > 0 else 0.0)
    return float(np.median(found)) if found else 0.0


def blocks(time: F64, table: F64, width: int) -> dict[str, int]:
    """Role -> the first of `width` columns side by side of a table (T, C): joint_pos, joint_vel, command.

    Empty where no block is the slope of another, or follows one: then nothing tells positions from all else.
    """
    time, table = time[:MOST], table[:MOST, :MOST_COLUMNS]
    starts = range(table.shape[1] - width + 1)
    parts = {k: table[:, k : k + width] for k in starts if np.nanmax(np.nanstd(table[:, k : k + width], axis=0)) > 1e-6}
    apart = [(a, b) for a in parts for b in parts if abs(a - b) >= width]
    slopes = {(p, v): _slope(time, parts[p], parts[v]) for p, v in apart}
    good = [pair for pair, corr in slopes.items() if corr > SLOPE]
    found: dict[str, int] = {}
    if good:
        place, speed = max(good, key=lambda pair: slopes[pair])
        found = {"joint_pos": place, "joint_vel": speed}
    asked = {(c, p): leads(time, parts[c], parts[p]) for c, p in apart if p == found.get("joint_pos", p)}
    asked = {pair: corr for pair, corr in asked.items() if pair[0] != found.get("joint_vel") and corr > LEADS}
    if asked:
        command, place = max(asked, key=lambda pair: asked[pair])
        found |= {"joint_pos": place, "command": command}
    return found


def _slope(time: F64, place: F64, speed: F64) -> float:
    """The smallest correlation, of the columns that move, of ways travelled with integrals."""
    found = []
    for k in range(place.shape[1]):
        moved, sums = travelled(time, place[:, k], speed[:, k])
        if len(moved) and np.nanstd(moved) > 1e-9:
            found.append(alike(sums, moved))
    return min(found, default=0.0)
