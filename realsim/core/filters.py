"""Filters of even samples. scipy.signal has them too, and takes a second to import."""

import math

import numpy as np

from realsim.core.types import F64


def local_fit(half: int, degree: int) -> F64:
    """(degree + 1, 2 * half + 1): times as many samples, one apart, the coefficients of the polynomial that fits them
    best, about their middle (Savitzky and Golay 1964)."""
    return np.linalg.pinv(np.vander(np.arange(-half, half + 1.0), degree + 1, increasing=True))


def local_polynomials(values: F64, half: int, degree: int, order: int, step: float) -> F64:
    """(N, K) derivative `order` of samples `step` apart, each by the polynomial over it and `half` samples to each
    side; nearer to an end, by the one over that end's."""
    fit = local_fit(half, degree)[order:]
    times = [math.perm(k, order) for k in range(order, degree + 1)]
    if len(values) < fit.shape[1]:
        raise ValueError(f"{len(values)} samples for windows of {fit.shape[1]}")

    def ends(at: F64) -> F64:
        return (np.vander(at, len(fit), increasing=True) * times) @ fit

    from scipy.ndimage import correlate1d

    found = correlate1d(np.asarray(values, float), times[0] * fit[0], axis=0, mode="constant")
    if half:
        found[:half] = ends(np.arange(-half, 0.0)) @ values[: fit.shape[1]]
        found[-half:] = ends(np.arange(1.0, half + 1)) @ values[-fit.shape[1] :]
    return np.asarray(found / step**order)


def low_pass(values: F64, keeps: float) -> F64:
    """(N, ...) what a first-order filter makes of samples (N, ...) that keeps this share of what it showed at the last;
    steady before the first."""
    from scipy.linalg import solve_banded

    if not values.size:  # no joints
        return np.asarray(values, float)
    given = (1 - keeps) * values
    given[0] += keeps * values[0]
    bands = np.array([np.ones(len(values)), np.full(len(values), -keeps)])
    # Not finite where a simulation diverged, which is refused by name later.
    found = solve_banded((1, 0), bands, given.reshape(len(values), -1), check_finite=False)
    return np.asarray(found).reshape(values.shape)
