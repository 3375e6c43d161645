"""Which of two series of timestamps belong together, and poses between samples."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import interpolated_T
from realsim.core.types import F64

SAME_INSTANT = 1e-6
"""Seconds: closer than what timestamps are printed with."""


def nearest(times: F64, at: F64) -> NDArray[np.intp]:
    """For each of `at` (M,) the index of the nearest of `times` (N,), sorted and not empty; ties go to the earlier."""
    right = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1))
    right = np.minimum(right, len(times) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(at - times[left] <= times[right] - at, left, right)


def associate(a: F64, b: F64, max_difference: float) -> list[tuple[int, int]]:
    """Index pairs (i, j) in order such that a[i] and b[j] are each other's nearest and at most `max_difference` apart.

    Being mutual makes the result one-to-one and independent of which series is called first.

    Args:
        a, b: sorted, strictly increasing seconds, (N,) and (M,).
    """
    if not len(a) or not len(b):
        return []
    to_b, to_a = nearest(b, a), nearest(a, b)
    pairs = []
    for i, j in enumerate(to_b):
        if to_a[j] == i and abs(a[i] - b[j]) <= max_difference:
            pairs.append((i, int(j)))
    return pairs


def interpolate_poses(times: F64, poses: F64, at: F64, max_gap: float, beside: float = 0.0) -> list[F64 | None]:
    """Poses at other times: positions linearly, rotations along the shortest arc (slerp, Shoemake 1985).

    Args:
        times: (N,) strictly increasing seconds.
        poses: (N, 4, 4) rigid.
        at: (M,) seconds.
        max_gap: the two samples around a time may be at most this far apart.
        beside: seconds; where they are farther apart, a sample so close to the time is taken as it is.

    Returns:
        One (4, 4) a time, or None where there are no samples close enough around it.
    """
    out: list[F64 | None] = [None] * len(at)
    if not len(times):
        return out
    closest, right = nearest(times, at), np.searchsorted(times, at)
    inner = np.flatnonzero((right > 0) & (right < len(times)))
    inner = inner[times[right[inner]] - times[right[inner] - 1] <= max_gap]
    if len(inner):
        for k, T in zip(inner, interpolated_T(times, poses, at[inner]), strict=True):
            out[k] = T
    for i, off in enumerate(np.abs(times[closest] - at)):
        if off <= (beside if out[i] is None else SAME_INSTANT):
            out[i] = poses[closest[i]].copy()
    return out
