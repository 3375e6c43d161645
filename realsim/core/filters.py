"""Filters of even samples, without scipy.signal: it and scipy.stats, which it asks for, take a second to import."""

from math import factorial

import numpy as np

from realsim.core.types import F64


def local_polynomials(values: F64, window: int, degree: int, deriv: int = 0, step: float = 1.0) -> F64:
    """(T, K) values or their `deriv`-th derivative by polynomials over an odd window (Savitzky and Golay 1964).

    Within half a window of an end, by the polynomial of the first or the last whole window.
    """
    from numpy.polynomial import polynomial
    from scipy.ndimage import convolve1d

    half, x = window // 2, np.arange(window)
    out = convolve1d(values, local_weights(window, degree, deriv, step), axis=0, mode="constant")
    for rows, ends in ((slice(None, window), slice(None, half)), (slice(-window, None), slice(-half, None))):
        slopes = polynomial.polyder(polynomial.polyfit(x, values[rows], degree), deriv)
        out[ends] = polynomial.polyval(x[ends], slopes).T / step**deriv
    return np.asarray(out)


def local_weights(window: int, degree: int, deriv: int = 0, step: float = 1.0) -> F64:
    """(window,) weights of the newest to the oldest sample in the middle's value, or its derivative."""
    powers = np.arange(window // 2, -window // 2, -1.0) ** np.arange(degree + 1)[:, None]
    wanted = np.zeros(degree + 1)
    wanted[deriv] = factorial(deriv) / step**deriv
    return np.asarray(np.linalg.lstsq(powers, wanted, rcond=None)[0])


def low_passed(values: F64, lag: float, step: float) -> F64:
    """(T, ...) response of a first-order filter of time constant `lag` to samples `step` apart, s; steady at first."""
    from scipy.linalg.blas import dtbsv

    keeps = np.exp(-step / lag) if lag > 0 else 0.0
    rows = np.asarray(values, float).reshape(len(values), -1)
    put_in = (1 - keeps) * rows
    put_in[0] = rows[0]
    band = np.ones((2, len(rows)), order="F")  # y[n] - keeps y[n - 1] = put_in[n]: diagonal, and what is below it
    band[1] = -keeps
    return np.stack([dtbsv(1, band, column, lower=1, diag=1) for column in put_in.T], 1).reshape(np.shape(values))
