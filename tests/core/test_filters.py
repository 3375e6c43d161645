"""Filters are those of scipy, which takes longer to import."""

import numpy as np
import pytest

from realsim.core.filters import local_fit, local_polynomials, low_pass

VALUES = np.random.default_rng(0).normal(size=(40, 3)).cumsum(0)


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("half", [2, 7, 19])
def test_local_polynomials(half: int, order: int, degree: int) -> None:
    from scipy.signal import savgol_filter

    found = local_polynomials(VALUES, half, degree, order, 0.01)
    expected = savgol_filter(VALUES, 2 * half + 1, degree, deriv=order, delta=0.01, axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_polynomial_is_fitted_exactly_and_too_few_samples_are_refused() -> None:
    t = np.arange(30) * 0.1
    found = local_polynomials((2 * t**3 - t)[:, None], 4, 3, 1, 0.1)
    np.testing.assert_allclose(found[:, 0], 6 * t**2 - 1, atol=1e-9)
    assert local_fit(4, 3).shape == (4, 9)
    with pytest.raises(ValueError, match="8 samples"):
        local_polynomials(VALUES[:8], 4, 3, 1, 0.1)


@pytest.mark.parametrize("keeps", [0.0, 0.3, 0.99])
def test_low_pass(keeps: float) -> None:
    from scipy.signal import lfilter

    expected = lfilter([1 - keeps], [1, -keeps], VALUES, axis=0, zi=keeps * VALUES[:1])[0]
    np.testing.assert_allclose(low_pass(VALUES, keeps), expected, rtol=1e-12)
    np.testing.assert_allclose(low_pass(VALUES[:, 1], keeps), expected[:, 1], rtol=1e-12)
    np.testing.assert_allclose(low_pass(np.full(9, 3.0), keeps), 3.0)
    for few in (VALUES[:, :0], VALUES[:1]):
        assert low_pass(few, keeps).shape == few.shape


def test_no_columns_are_filtered_to_none() -> None:
    assert local_polynomials(VALUES[:, :0], 2, 2, 1, 0.1).shape == (len(VALUES), 0)
