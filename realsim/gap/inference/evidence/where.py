"""Where the gap lies: shares of the squared error by signal, joint and phase of motion, and what else tells."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.core.statistics import resampled
from realsim.core.types import F64
from realsim.gap.case.model.channels import named_place
from realsim.gap.inference.evidence.inverse import base_wrench, torque_residual
from realsim.gap.inference.evidence.shooting import Shots, shoot
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator

PHASES = ("at rest", "reversal", "slow", "fast forward", "fast backward")
LEAST_SHARE = 0.005
"""Smaller shares of the gap are not listed."""
PLAIN_SHARE, PLAIN_EXCESS = 0.1, 3.0
"""A single event can be most of the gap: from this share and this mean error (in floors) no scatter test is asked."""
BLOCK_SECONDS = 0.5
FEWEST_BLOCKS = 12
"""Short logs are cut into shorter blocks, so that there are at least as many."""
FALSE_SHARE = 0.1
"""Expected share of false names among those that are named."""
RESAMPLES = 400


def phases(comparison: Comparison, run: int, track: dict[str, F64], joint: int | None) -> F64:
    """(B,) index into PHASES, from the nominal simulator's velocity (of one joint, or the fastest)."""
    index = comparison.rows_at(run, track)
    speed = np.nan_to_num(track["vel"])
    peak = np.maximum(np.abs(speed).max(axis=0), 1e-6)
    scaled = speed / peak
    v = scaled[index, joint] if joint is not None else np.abs(scaled[index]).max(axis=1, initial=0.0)
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
    """(entries of the contract's `where`, largest first; (C, phases) share of the total squared gap).

    An entry is listed only where the error lies above the floor by more than its scatter between blocks of half a
    second, with false names held down, or where it is most plain; the shares are of the whole gap, so what is not
    listed is missing from the sum.
    """
    count = len(comparison.channels)
    shares = np.zeros((count, len(PHASES)))
    names = comparison.case.joint_names
    signed = excesses(comparison, residuals)
    index = {c.label: names.index(c.label) for c in comparison.channels if c.label in names}
    at: list[dict[int | None, F64]] = []
    for run, excess in zip(runs, signed, strict=True):
        joints = {index.get(c.label) for c in comparison.channels}
        at.append({j: phases(comparison, run, tracks[run], j) for j in joints})
        for c, channel in enumerate(comparison.channels):
            above = np.maximum(excess[:, c], 0)
            shares[c] += np.bincount(at[-1][index.get(channel.label)], weights=above, minlength=len(PHASES))
    shares /= max(shares.sum(), 1e-12)
    listed = [(c, p) for c in range(count) for p in range(len(PHASES)) if shares[c, p] > LEAST_SHARE]
    chances = []
    for c, p in listed:
        j = index.get(comparison.channels[c].label)
        chances.append(tail(comparison, [e[:, c] for e in signed], [a[j] == p for a in at], 0.0))
    entries = []
    for (c, p), yes, (_, mean) in zip(listed, significant([p for p, _ in chances]), chances, strict=True):
        channel = comparison.channels[c]
        if yes or (mean > PLAIN_EXCESS and shares[c, p] > PLAIN_SHARE):
            place = named_place(comparison.case, channel)
            entries.append({"signal": channel.signal, **place, "phase": PHASES[p], "share": float(shares[c, p])})
    entries.sort(key=lambda e: -float(str(e["share"])))
    return entries[:40], shares


def by_signal(comparison: Comparison, shares: F64) -> dict[str, float]:
    """Share of the gap by signal."""
    result: dict[str, float] = {}
    for c, channel in enumerate(comparison.channels):
        result[channel.signal] = result.get(channel.signal, 0.0) + float(shares[c].sum())
    return result


def evidence(simulator: Simulator, comparison: Comparison, residuals: Sequence[F64], seed: int = 0) -> dict[str, Any]:
    """What else says where the gap lies, as plain data for `statistics`: horizons, residuals."""
    found: dict[str, Any] = {"error_by_horizon": horizons(shoot(simulator), comparison, residuals)}
    torque = torque_residual(simulator)
    if torque is not None:
        found["torque_residual"] = {
            joint: {"rms_Nm": float(torque.rms[j]), "share": float(torque.share[j]), **torque.terms[j]}
            for j, joint in enumerate(torque.joints)
        }
    wrench = base_wrench(simulator, seed)
    if wrench is not None:
        axes = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
        found["base_wrench"] = {
            a: {"value": float(m), "unit": "N" if a.startswith("force") else "N m", "ci90": c.tolist()}
            for a, m, c in zip(axes, wrench.mean, wrench.ci90, strict=True)
        } | {"mass_kg": wrench.mass}
    return found


def by_horizon(shots: Sequence[Shots]) -> dict[str, dict[str, dict[str, float | None]]]:
    """By signal and horizon: error of predictions from estimated states, before and (where there are two) after."""
    before, after = (shot.growth() for shot in (shots[0], shots[-1]))
    return {
        s: {at: {"before": v, "after": after.get(s, {}).get(at)} for at, v in row.items()} for s, row in before.items()
    }


def horizons(shots: Shots, comparison: Comparison, residuals: Sequence[F64]) -> dict[str, dict[str, float | None]]:
    """By signal: root mean square error at each horizon from estimated states, and over the whole run from rest."""
    found = shots.growth()
    for signal, row in found.items():
        columns = [i for i, c in enumerate(comparison.channels) if c.signal == signal]
        row["whole run"] = float(np.sqrt(np.nanmean(np.concatenate([r[:, columns] for r in residuals]) ** 2)))
    return found


def excesses(comparison: Comparison, residuals: Sequence[F64]) -> list[F64]:
    """(B, C) a run: squared error in units of the floor, less one; its mean is zero where there is no gap."""
    return [np.nan_to_num(r**2 / comparison.floor(i) - 1) for i, r in enumerate(residuals)]


def significant(p: Sequence[float], false_share: float = FALSE_SHARE) -> list[bool]:
    """Which of many tests to believe so that at most this share of them is expected to be false."""
    if not len(p):
        return []
    found = np.sort(np.asarray(p, float))
    fits = found * (len(p) / np.arange(1, len(p) + 1)) <= false_share  # Benjamini and Hochberg 1995
    most = float(found[fits].max(initial=-1.0))
    return [one <= most for one in p]


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
