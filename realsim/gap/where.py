"""Where the gap lies: shares of the squared normalised error by signal, joint, phase of motion and horizon."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.gap.compare import Comparison
from realsim.types import F64

PHASES = ("at rest", "reversal", "slow", "fast forward", "fast backward")
HORIZONS = (0.02, 0.1, 0.5)


def phases(comparison: Comparison, run: int, track: dict[str, F64], joint: int | None) -> F64:
    """(B,) index into PHASES, from the nominal simulator's velocity (of one joint, or the fastest)."""
    settle, dt = track["settle"]
    index = np.clip(((comparison.times[run] + settle) / dt).astype(int), 0, len(track["vel"]) - 1)
    speed = np.nan_to_num(track["vel"])
    peak = np.maximum(np.abs(speed).max(axis=0), 1e-6)
    scaled = speed / peak
    v = scaled[index, joint] if joint is not None else np.abs(scaled[index]).max(axis=1)
    result = np.where(np.abs(v) < 0.25, 2, np.where(v > 0, 3, 4))
    near = np.zeros(len(v), bool)
    moving = np.flatnonzero(np.abs(v) > 0.03)
    flips = moving[1:][np.sign(v[moving[1:]]) != np.sign(v[moving[:-1]])] if len(moving) else []
    width = max(int(0.06 / comparison.config.bin_seconds), 1)
    for f in flips:
        near[max(f - width, 0) : f + width] = True
    result[near] = 1
    result[(np.abs(v) < 0.01) & ~near] = 0
    return result


def localise(
    comparison: Comparison, residuals: Sequence[F64], runs: Sequence[int], tracks: Sequence[dict[str, F64]]
) -> tuple[list[dict[str, Any]], F64]:
    """(entries of the contract's `where`, largest first; (C, phases) share of the total squared gap)."""
    shares = np.zeros((len(comparison.channels), len(PHASES)))
    names = comparison.case.joint_names
    for run, r in zip(runs, residuals, strict=True):
        excess = np.nan_to_num(np.maximum(r**2 / comparison.floor(run) - 1, 0))
        cache: dict[int | None, F64] = {}
        for c, channel in enumerate(comparison.channels):
            joint = names.index(channel.label) if channel.label in names else None
            if joint not in cache:
                cache[joint] = phases(comparison, run, tracks[run], joint)
            shares[c] += np.bincount(cache[joint], weights=excess[:, c], minlength=len(PHASES))
    shares /= max(shares.sum(), 1e-12)
    entries = []
    for c, channel in enumerate(comparison.channels):
        for p, phase in enumerate(PHASES):
            if shares[c, p] > 0.005:
                place = {"joint": channel.label} if channel.signal.startswith("joint") else {"body": channel.label}
                entries.append({"signal": channel.signal, **place, "phase": phase, "share": float(shares[c, p])})
    entries.sort(key=lambda e: -float(str(e["share"])))
    return entries[:40], shares


def by_signal(comparison: Comparison, shares: F64) -> dict[str, float]:
    """Share of the gap by signal."""
    result: dict[str, float] = {}
    for c, channel in enumerate(comparison.channels):
        result[channel.signal] = result.get(channel.signal, 0.0) + float(shares[c].sum())
    return result


def by_horizon(comparison: Comparison, residuals: Sequence[F64]) -> dict[str, float]:
    """Root mean square growth of the joint position error over each horizon, and over the whole run, rad.

    A gap that grows at once is in the sensors or the drive; one that needs long is in inertia, load or drift.
    """
    columns = [i for i, c in enumerate(comparison.channels) if c.signal == "joint_pos"]
    result = {}
    for horizon in HORIZONS:
        lag = max(round(horizon / comparison.config.bin_seconds), 1)
        growth = [r[lag:, columns] - r[:-lag, columns] for r in residuals if len(r) > lag]
        if growth:
            result[f"{horizon:g} s"] = float(np.sqrt(np.nanmean(np.concatenate(growth) ** 2)))
    result["whole run"] = float(np.sqrt(np.nanmean(np.concatenate([r[:, columns] for r in residuals]) ** 2)))
    return result
