"""The robot's state along a run, estimated from the log: positions, velocities and accelerations.

Two ways, for two uses. Local cubics are nearly unbiased, so predictions start from them. A Gaussian and its
derivatives blur everything alike, so an equation between blurred quantities (inverse dynamics against a torque that was
blurred too) still holds where the motion is faster than the window.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.core.errors import GapError
from realsim.core.filters import local_polynomials, local_weights, low_passed
from realsim.core.geometry import cross
from realsim.core.types import F64, Bool
from realsim.gap.case.case import Case, Run
from realsim.gap.case.runs import usual_step

HALF_WINDOW = 0.035
"""Seconds to each side that a cubic is fitted over: shorter than a servo's response, longer than encoder noise."""
BLUR = 0.015
"""Standard deviation of the Gaussian, s."""
TAILS = 8.0
"""Standard deviations at which the Gaussian is cut off; see `blur`."""
Smoother = Callable[[F64, F64, F64], tuple[F64, F64, F64]]


@dataclass(frozen=True)
class Motion:
    """Estimated states in the coordinates of the nominal model. Joints that were not logged stay at their default."""

    time: F64
    """(N,) even steps, s."""
    qpos: F64
    """(N, nq)"""
    qvel: F64
    """(N, nv)"""
    qacc: F64
    """(N, nv)"""
    good: Bool
    """(N,) bool, whether every logged signal has samples near by."""


def estimate(case: Case, run: Run, smoother: Smoother | None = None) -> Motion:
    """States on even steps of the log's median sampling time. Raises GapError for a run of fewer than 9 samples."""
    smoother = smoother or smooth
    step = float(np.median(np.diff(run.time)))
    time = np.arange(0.0, run.time[-1] + 1e-9, step)
    if len(time) < 9:
        raise GapError("the run is too short to estimate velocities", found=f"{len(time)} steps in {run.name}")
    model = case.model
    qpos = np.tile(model.qpos0 if run.init_qpos is None else run.init_qpos, (len(time), 1))
    qvel, qacc = np.zeros((len(time), model.nv)), np.zeros((len(time), model.nv))
    joints = run.signals["joint_pos"]
    good = _near(run.time, np.isfinite(joints).all(axis=1), time)
    value, rate, change = smoother(time, run.time, joints) if case.joint_names else (joints,) * 3
    for j, name in enumerate(case.joint_names):
        part = model.joint(name)
        qpos[:, part.qposadr[0]] = value[:, j]
        qvel[:, part.dofadr[0]], qacc[:, part.dofadr[0]] = rate[:, j], change[:, j]
    if case.floating and "base_pos" in run.signals:
        adr, dof = _free(case)
        place = run.signals["base_pos"]
        good &= _near(run.time, np.isfinite(place).all(axis=1), time)
        value, rate, change = smoother(time, run.time, place)
        qpos[:, adr : adr + 3], qvel[:, dof : dof + 3], qacc[:, dof : dof + 3] = value, rate, change
        if "base_quat" in run.signals:
            quat, turn, spin = _rotation(time, run.time, run.signals["base_quat"], smoother)
            qpos[:, adr + 3 : adr + 7], qvel[:, dof + 3 : dof + 6], qacc[:, dof + 3 : dof + 6] = quat, turn, spin
    return Motion(time, qpos, qvel, qacc, good)


def smooth(grid: F64, time: F64, values: F64) -> tuple[F64, F64, F64]:
    """(value, first, second derivative) on even steps `grid` of (T, K) samples, by local cubics; NaN is bridged."""
    value, rate, change = (_cubics(grid, time, values, order) for order in range(3))
    return value, rate, change


def _cubics(grid: F64, time: F64, values: F64, order: int) -> F64:
    """One of these derivatives."""
    even = np.stack([_bridge(grid, time, column) for column in values.T], axis=1)
    step = float(grid[1] - grid[0])
    half = int(np.clip(round(HALF_WINDOW / step), 3, (len(grid) - 1) // 2))
    return local_polynomials(even, 2 * half + 1, 3, order, step)


def rate_gain(time: F64) -> float:
    """Standard deviation of a velocity that `smooth` estimates from readings of standard deviation 1, 1/s."""
    step = float(np.median(np.diff(time)))
    half = int(np.clip(round(HALF_WINDOW / step), 3, max((len(time) - 1) // 2, 3)))
    return float(np.linalg.norm(local_weights(2 * half + 1, 3, 1, step)))


def blur(grid: F64, time: F64, values: F64) -> tuple[F64, F64, F64]:
    """The same through a Gaussian and its derivatives: all three are blurred alike."""
    from scipy.ndimage import gaussian_filter1d

    even = np.stack([_bridge(grid, time, column) for column in values.T], axis=1)
    step = float(grid[1] - grid[0])
    wide = max(BLUR / step, 1.0)
    # Cut off at 4 widths (scipy's default), the second derivative's kernel does not sum to 0, and rest accelerates.
    return tuple(
        gaussian_filter1d(even, wide, axis=0, order=d, mode="nearest", truncate=TAILS) / step**d for d in (0, 1, 2)
    )


def _bridge(grid: F64, time: F64, column: F64) -> F64:
    finite = np.isfinite(column)
    return np.interp(grid, time[finite], column[finite]) if finite.any() else np.zeros(len(grid))


def _near(time: F64, finite: Any, grid: F64) -> Bool:
    """(N,) whether a finite sample lies within half a window on both sides."""
    have = time[finite]
    if not len(have):
        return np.zeros(len(grid), bool)
    right = np.searchsorted(have, grid).clip(0, len(have) - 1)
    left = np.searchsorted(have, grid, side="right").clip(1, len(have)) - 1
    return np.asarray((np.abs(have[right] - grid) < HALF_WINDOW) & (np.abs(have[left] - grid) < HALF_WINDOW))


def _rotation(grid: F64, time: F64, quat: F64, smoother: Smoother) -> tuple[F64, F64, F64]:
    """(w x y z, angular velocity, angular acceleration), the latter two in the body's frame, as MuJoCo has them."""
    finite = np.isfinite(quat).all(axis=1)
    q = quat[finite] / np.linalg.norm(quat[finite], axis=1, keepdims=True)
    flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    q, dq, ddq = smoother(grid, time[finite], q)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    q, dq, ddq = q / length, dq / length, ddq / length
    return q, 2 * _conjugate_times(q, dq), 2 * _conjugate_times(q, ddq)


def _conjugate_times(p: F64, q: F64) -> F64:
    """Vector part of conj(p) * q, row by row."""
    w, v = p[:, :1], -p[:, 1:]
    return w * q[:, 1:] + q[:, :1] * v + cross(v, q[:, 1:])


def _free(case: Case) -> tuple[int, int]:
    """First position and velocity address of the floating base."""
    joint = int(np.flatnonzero(case.model.jnt_type == 0)[0])
    return int(case.model.jnt_qposadr[joint]), int(case.model.jnt_dofadr[joint])


ROOM = 0.5
"""If fewer than this fraction of samples have neighbours, the signal counts as sampled more slowly than the log."""


def median_size(kinks: F64) -> float:
    """Median of the absolute values; 0 where there are none."""
    return float(np.median(np.abs(kinks))) if len(kinks) else 0.0


def differences(column: F64, order: int) -> F64:
    """Finite differences of (T,) samples; white noise of deviation s has sqrt(6) s in second, sqrt(20) s in third ones.

    They are those of neighbouring rows; where most of these have a hole, those of neighbouring finite samples. A hole
    or two are left out, since a difference across them holds more of the motion than of the noise. But a signal that
    fills every other row has no neighbours at all.
    """
    finite = np.isfinite(column)
    found = np.diff(column, order)
    found = found[np.isfinite(found)]
    if len(found) < ROOM * (finite.sum() - order):
        found = np.diff(column[finite], order)
    return found


LAGS, SHORTEST_LAG, FINE = np.arange(0.0, 0.1001, 0.002), 0.008, 0.005
"""s of a filter that a drive may report its velocity through; the least that is told from noise, and from a simulator's
own half step, by which its speeds are behind its positions; and s of a step that shows it."""
FILTERED = 0.5
"""Share of the squared difference between velocities and slopes that a filter's lag must explain. Not tuned."""


def velocity_lag(case: Case) -> float:
    """Time constant, s, of the first-order filter through which joint_vel shows the slope of joint_pos; 0 where it has
    none. Drives filter what they difference, and tables hold differences to the sample before."""
    shares = []
    for run in case.runs if case.has("joint_vel") and case.has("joint_pos") else ():
        step = min(usual_step(run.time), FINE)
        grid = np.arange(0.0, run.time[-1], step)
        speeds = np.stack([_bridge(grid, run.time, c) for c in run.signals["joint_vel"].T], axis=1)
        way = np.cumsum((speeds[1:] + speeds[:-1]) * step / 2, axis=0, dtype=float)  # blurred as positions are
        slope = _cubics(grid, run.time, run.signals["joint_pos"], 1)
        reference = _cubics(grid, grid, np.concatenate([np.zeros_like(speeds[:1]), way]), 1)
        size = np.maximum(np.std(slope, axis=0), 1e-3)
        left = np.array([np.mean(((low_passed(slope, lag, step) - reference) / size) ** 2) for lag in LAGS])
        shares.append(left / max(left[0], 1e-12))
    if not shares:
        return 0.0
    usual = np.median(shares, axis=0)  # one spoilt run does not decide
    best = int(np.argmin(usual))
    return float(LAGS[best]) if LAGS[best] >= SHORTEST_LAG and usual[best] < 1 - FILTERED else 0.0


def sample_noise(case: Case, column: int, signal: str = "joint_pos") -> float:
    """Standard deviation of a sample's noise in one column of a signal, from third differences of all runs."""
    kinks = [differences(r.signals[signal][:, column], 3) / np.sqrt(20) for r in case.runs]
    return 1.4826 * median_size(np.concatenate(kinks))
