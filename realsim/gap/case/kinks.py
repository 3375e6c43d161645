"""High frequencies of a logged column: differences in which hardly anything but its noise is left."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64

ROOM = 0.5
"""If fewer than this fraction of samples have neighbours, the signal counts as sampled more slowly than the log."""


def second_differences(column: F64) -> F64:
    """Finite second differences of (T,) samples; white noise of deviation s has sqrt(6) s in them."""
    return _kinks(column, 2)


def third_differences(column: F64) -> F64:
    """Finite third differences of (T,) samples; white noise of deviation s has sqrt(20) s in them."""
    return _kinks(column, 3)


def median_size(kinks: F64) -> float:
    """Median of the absolute values; 0 where there are none."""
    return float(np.median(np.abs(kinks))) if len(kinks) else 0.0


def _kinks(column: F64, order: int) -> F64:
    """Those of neighbouring rows; where most of these have a hole, those of neighbouring finite samples.

    A hole or two are left out, since a difference across them holds more of the motion than of the noise. But a signal
    that fills every other row has no neighbours at all.
    """
    finite = np.isfinite(column)
    found = _difference(column, order)
    found = found[np.isfinite(found)]
    if len(found) < ROOM * (finite.sum() - order):
        found = _difference(column[finite], order)
    return found


def _difference(x: F64, order: int) -> F64:
    if order == 2:
        return x[:-2] - 2 * x[1:-1] + x[2:]
    return x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3]
