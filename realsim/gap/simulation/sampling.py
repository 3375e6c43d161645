"""Signals between two grids of time: held commands averaged, readings interpolated, rotations as vectors."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from realsim.types import F64


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


def rotation_from(quat: F64, reference: F64) -> F64:
    """(T, 3) rotation vectors, world axes, that turn the reference orientation into each of quat (T, 4) w x y z."""
    q = quat / np.maximum(np.linalg.norm(quat, axis=1, keepdims=True), 1e-12)
    w0, v0 = reference[0], -np.asarray(reference[1:])
    w = q[:, 0] * w0 - q[:, 1:] @ v0
    v = q[:, :1] * v0 + w0 * q[:, 1:] + np.cross(q[:, 1:], v0)
    v, w = np.where(w[:, None] < 0, -v, v), np.abs(w)
    norm = np.linalg.norm(v, axis=1)
    angle = 2 * np.arctan2(norm, w)
    return v * np.where(norm > 1e-9, angle / np.maximum(norm, 1e-9), 2.0)[:, None]


@contextlib.contextmanager
def quiet_mujoco() -> Any:
    """Failures are found by value; without this MuJoCo writes them to a log file in the working directory too."""
    import mujoco

    setter, previous = mujoco.set_mju_user_warning, mujoco.get_mju_user_warning()
    setter(_swallow)
    try:
        yield
    finally:
        setter(previous)


def _swallow(message: str) -> None:
    del message
