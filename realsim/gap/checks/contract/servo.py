"""The servos' gains, by the torque that the drives report: torque = kp (target - q) - kd dq."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from realsim.core.types import F64
from realsim.gap.checks.contract.policy import Contract
from realsim.gap.checks.contract.proposals import listed
from realsim.gap.checks.contract.search import FLOOR, PRICE
from realsim.gap.checks.contract.steps import LEAST, Run, Steps

EXPLAINED = 0.5
"""Rms share of a torque that the servo's law may leave, with gains of its own, and of a joint's way from row to row
that its velocities may leave, for those gains to be believed: a quarter of the variance."""
SAME = 0.15
"""Relative difference below which a gain is as it should be: rounding, how well drives know their torque, and rows that
miss what a stiff joint does between them (up to 0.11 at 50 Hz on the simulated quadruped)."""
AGES = np.linspace(0, 1, 33)
"""Rows by which the readings behind a torque are older than its row. Between steps of an eighth, a joint that speeds up
within a row made gains of 1.15 to 1.19 (3 in 94 logs of a hexapod with right gains; with these none, and as many wrong
gains are found)."""


def check_gains(contract: Contract, steps: Steps) -> str | None:
    """What is off about the gains, in words; None where nothing is, or no torque is logged.

    Judged as all mistakes are: fitted gains must take away a third of the variance that the contract's leave in some
    joint (`search.PRICE`).
    """
    runs = [r for r in steps.runs if r.torque is not None]
    if not runs:
        return None
    order = [steps.joints.index(j) for j in contract.joints]
    n = len(order)
    # A drive reports the torque of a moment between two rows: the one that explains all joints best.
    moments = [_rows(contract, runs, order, late, age) for late in (0, 1) for age in AGES]
    rows = min(moments, key=_left)
    kp, kd, off, explained = np.ones(n), np.ones(n), np.zeros(n, bool), np.zeros(n, bool)
    for i, (x, y) in enumerate(rows):
        floor = max(FLOOR * float(np.std(y)), 1e-9)
        found = _gains(x, y, floor)
        after = _scale(y - x @ found, floor)
        # A damping that readings of another moment explain as well is none: kp times the way of a part of a row.
        before = min(_scale(m[i][1] - m[i][0].sum(axis=1), floor) for m in moments)
        explained[i] = after < EXPLAINED * max(float(np.std(y)), 1e-9)
        off[i] = explained[i] and _resolved(runs, order[i]) and np.log(before / after) > PRICE
        # No difference: an interval of three sigma that includes 1, or less than the share that the law leaves.
        least = np.maximum(
            max(SAME, after / max(float(np.std(y)), 1e-9)), 3 * after * np.sqrt(np.diag(np.linalg.pinv(x.T @ x)))
        )
        kp[i], kd[i] = (v if abs(v - 1) > s else 1.0 for v, s in zip(found, least, strict=True))
    if explained.sum() < 0.5 * n:  # these torques are another law's
        return None
    kp, kd = np.where(off, kp, 1.0), np.where(off, kd, 1.0)
    words = [
        f"{name} is {listed(contract.joints, ratio, 1.0, '{:.3g} times what it should be')}"
        for name, ratio in (("kp", kp), ("kd", kd))
        if (ratio != 1).any()
    ]
    if not words:
        return None
    both = bool(np.all(np.abs(kp - kd)[off] < SAME))
    return " and ".join(words) + (" (or torques are reported by that factor)" if both else "")


def _resolved(runs: Sequence[Run], j: int) -> bool:
    """Whether the rows show the motion: a joint that turns back between them has no damping in them."""
    way = np.concatenate([np.diff(r.pos[:, j]) for r in runs])
    of_velocity = np.concatenate([(r.vel[1:, j] + r.vel[:-1, j]) / 2 * np.diff(r.time) for r in runs])
    return bool(np.sum((way - of_velocity) ** 2) < EXPLAINED**2 * np.sum(way**2))


def _gains(x: F64, y: F64, floor: float) -> F64:
    """(2,) ratios to the contract's gains, from the contract's, under a Cauchy loss: a limit or a blow is no gain."""
    scale = _scale(y - x.sum(axis=1), floor)
    return np.asarray(least_squares(lambda g: y - x @ g, np.ones(2), jac=lambda g: -x, loss="cauchy", f_scale=scale).x)


def _scale(rest: F64, floor: float) -> float:
    """The standard deviation that a normal distribution of the same median size has, and the floor's."""
    return float(np.hypot(1.4826 * np.median(np.abs(rest)), floor))


Rows = list[tuple[F64, F64]]
"""Of each joint: (rows, 2) torques of either gain of the contract, (rows,) measured."""


def _rows(contract: Contract, runs: Sequence[Run], order: Sequence[int], late: int, age: float) -> Rows:
    """Torques beside what the contract's law makes of the command `late` rows ago and readings `age` rows old.

    Rows in which a drive is at its limit are left out.
    """
    found = []
    for i, j in enumerate(order):
        parts, measured = [], []
        for r in runs:
            assert r.torque is not None
            pos, vel = ((1 - age) * v[1:, j] + age * v[:-1, j] for v in (r.pos, r.vel))
            command = r.command[:-1, j] if late else r.command[1:, j]
            parts.append(np.stack([contract.kp[i] * (command - pos), -contract.kd[i] * vel], axis=1))
            measured.append(r.torque[1:, j])
        x, y = np.concatenate(parts), np.concatenate(measured)
        most = 0.98 * np.abs(y).max()
        kept = np.abs(y) < most
        if kept.mean() > 0.98 or kept.sum() < LEAST:
            kept[:] = True
        found.append((x[kept], y[kept]))
    return found


def _left(rows: Rows) -> float:
    """Mean log of what the law leaves with free gains."""
    rest = [y - x @ np.linalg.lstsq(x, y, rcond=None)[0] for x, y in rows]
    return float(np.mean([np.log(np.std(r) + 1e-9) for r in rest]))
