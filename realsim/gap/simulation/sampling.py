"""Signals between two grids of time: held commands averaged, readings interpolated, rotations as vectors."""

import contextlib
import ctypes
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from realsim.core.geometry import cross
from realsim.core.types import F64

AT = 1e-3
"""Rows by which a jump may miss a sample and be at it."""


def held_mean(time: F64, values: F64, grid: Any) -> F64:
    """Mean over [grid[k], grid[k+1]] of values (T, U) that are held from each time stamp to the next; (N - 1, U)."""
    span = np.diff(time, append=time[-1] + 1.0)[:, None]
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values * span, axis=0)])
    index = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)
    at = integral[index] + values[index] * (grid - time[index])[:, None]
    return np.diff(at, axis=0) / np.diff(grid)[:, None]


def sample(values: F64, position: F64) -> F64:
    """Linear interpolation of rows (N, K) at fractional row numbers."""
    position = np.clip(position, 0, len(values) - 1.000001)
    low = position.astype(int)
    w = (position - low)[:, None]
    return values[low] * (1 - w) + values[low + 1] * w


def either_side(values: F64, position: F64, jumps: F64) -> tuple[F64, F64]:
    """Rows (N, K) at fractional row numbers, where they jump at others: (before, after) a jump that is at a sample.

    A row in whose step a jump falls (of a new command, say) is a mean of both sides and belongs to none. What lies near
    one is carried on from the rows of its own side, with limited slopes (minmod: the smaller of two neighbours, none
    where they disagree), so that no impact is carried on with it.

    Args:
        jumps: in ascending order; one within `AT` rows of a sample is at it.
    """
    low = np.clip(position.astype(int), 3, len(values) - 4)
    w = (position - low)[:, None]
    slope = np.diff(values, axis=0)
    between = values[low] + w * slope[low]
    earlier = values[low - 1] + (1 + w) * _limited(slope[low - 2], slope[low - 3])
    later = values[low + 1] - (1 - w) * _limited(slope[low + 1], slope[low + 2])
    ahead = values[low] + w * _limited(slope[low - 1], slope[low - 2])
    nearest = jumps[np.clip(np.searchsorted(jumps, low), 0, len(jumps) - 1)]
    step = (nearest.astype(int) - low)[:, None]
    passed = (nearest < position - AT)[:, None]
    near = np.abs(nearest - position)[:, None] <= AT
    here = np.where(passed, later, earlier)
    before = np.where(step == 0, here, np.where(step == 1, ahead, between))
    return before, np.where(near, later, before)


def _limited(a: F64, b: F64) -> F64:
    return np.where(a * b > 0, np.sign(a) * np.minimum(np.abs(a), np.abs(b)), 0.0)


def rotation_from(quat: F64, reference: F64) -> F64:
    """(T, 3) rotation vectors, world axes, that turn the reference orientation into each of quat (T, 4) w x y z."""
    q = quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-12)
    w0, v0 = reference[0], -np.asarray(reference[1:])
    w = q[:, 0] * w0 - q[:, 1:] @ v0
    v = q[:, :1] * v0 + w0 * q[:, 1:] + cross(q[:, 1:], v0)
    v, w = np.where(w[:, None] < 0, -v, v), np.abs(w)
    norm = np.linalg.norm(v, axis=1)
    angle = 2 * np.arctan2(norm, w)
    return v * np.where(norm > 1e-9, angle / np.maximum(norm, 1e-9), 2.0)[:, None]


def nearest_turn(vectors: F64, to: F64) -> F64:
    """(T, 3) the same orientations, each as the rotation vector nearest to that of `to`: whole turns about its axis."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-9)[:, None]
    turns = np.nan_to_num(np.round(((axis * to).sum(axis=1) - angle) / (2 * np.pi)))
    return vectors + np.where(turns[:, None] != 0, 2 * np.pi * turns[:, None] * axis, 0.0)


def continuous_turn(vectors: F64) -> F64:
    """(T, 3) rotation vectors without the jump from half a turn to minus half a turn; NaN rows are stepped over."""
    known = np.flatnonzero(np.isfinite(vectors).all(axis=1))
    result = vectors.copy()
    if not (np.linalg.norm(np.diff(vectors[known], axis=0), axis=1) > np.pi).any():
        return result
    for before, row in pairwise(known):
        result[row] = nearest_turn(vectors[row : row + 1], result[before : before + 1])[0]
    return result


@contextlib.contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Failures are found by value; without this MuJoCo writes them to a log file in the working directory too.

    Its profiler is off meanwhile: it reads the clock two dozen times a step, a third of a pendulum's time.
    """
    import mujoco

    setter, previous = mujoco.set_mju_user_warning, mujoco.get_mju_user_warning()
    clock = _clock()
    before = clock.value
    setter(_swallow)
    clock.value = None
    try:
        yield
    finally:
        clock.value = before
        setter(previous)


@cache
def _clock() -> ctypes.c_void_p:
    """MuJoCo's `mjcb_time`, empty for no profiler; in Python it has one that `set_mjcb_time` cannot take away."""
    try:
        from mujoco import _callbacks

        return ctypes.c_void_p.in_dll(ctypes.CDLL(_callbacks.__file__), "mjcb_time")
    except (ImportError, OSError, ValueError):  # a library that does not show it: as slow as ever
        return ctypes.c_void_p()


def _swallow(message: str) -> None:
    del message
