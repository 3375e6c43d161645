"""Filters of even samples, by scipy.signal, which takes a second to import: only where samples are filtered."""

import numpy as np

from realsim.core.types import F64


def local_polynomials(values: F64, window: int, degree: int, deriv: int = 0, step: float = 1.0) -> F64:
    """(T, K) values or their `deriv`-th derivative by polynomials over an odd window (Savitzky and Golay 1964)."""
    from scipy.signal import savgol_filter

    return np.asarray(savgol_filter(values, window, degree, deriv=deriv, delta=step, axis=0))


def local_weights(window: int, degree: int, deriv: int = 0, step: float = 1.0) -> F64:
    """(window,) weights of the newest to the oldest sample in the middle's value, or its derivative."""
    from scipy.signal import savgol_coeffs

    return np.asarray(savgol_coeffs(window, degree, deriv=deriv, delta=step))


def low_passed(values: F64, lag: float, step: float) -> F64:
    """(T, ...) response of a first-order filter of time constant `lag` to samples `step` apart, s; steady at first."""
    from scipy.signal import lfilter

    keeps = np.exp(-step / lag) if lag > 0 else 0.0
    return np.asarray(lfilter([1 - keeps], [1, -keeps], values, axis=0, zi=keeps * np.asarray(values)[:1])[0])
