"""Filters do what scipy.signal's do, which takes a second to import."""

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_coeffs, savgol_filter

from realsim.core.filters import local_polynomials, local_weights, low_passed

VALUES = np.random.default_rng(0).normal(size=(60, 2)).cumsum(0)


@pytest.mark.parametrize("deriv", range(3))
@pytest.mark.parametrize(("window", "degree"), [(7, 2), (21, 3)])
def test_local_polynomials(window: int, degree: int, deriv: int) -> None:
    weights = savgol_coeffs(window, degree, deriv=deriv, delta=0.1)
    np.testing.assert_allclose(local_weights(window, degree, deriv, 0.1), weights, atol=1e-12)
    known = savgol_filter(VALUES, window, degree, deriv=deriv, delta=0.1, axis=0)
    np.testing.assert_allclose(local_polynomials(VALUES, window, degree, deriv, 0.1), known, atol=1e-9)


@pytest.mark.parametrize("values", [VALUES, VALUES[:, 0]])
def test_low_passed(values: np.ndarray) -> None:
    keeps = np.exp(-0.01 / 0.05)
    known, _ = lfilter([1 - keeps], [1, -keeps], values, axis=0, zi=keeps * values[:1])
    np.testing.assert_allclose(low_passed(values, 0.05, 0.01), known, atol=1e-12)
    np.testing.assert_array_equal(low_passed(values, 0.0, 0.01), values)
