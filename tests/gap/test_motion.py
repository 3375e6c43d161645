"""Derivatives of a log."""

from __future__ import annotations

import numpy as np
import pytest

from realsim.gap.case.motion import blur, smooth


@pytest.mark.parametrize("rate", [47.0, 100.0, 500.0, 1000.0])
@pytest.mark.parametrize("smoother", [blur, smooth])
def test_a_joint_at_rest_neither_moves_nor_accelerates(rate: float, smoother) -> None:
    time = np.arange(0.0, 2.0, 1 / rate)
    value, speed, change = smoother(time, time, np.ones((len(time), 1)))
    assert value == pytest.approx(1.0, abs=1e-9)
    assert np.abs(speed).max() < 1e-6
    assert np.abs(change).max() < 1e-3


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_a_parabola_has_its_own_acceleration(rate: float) -> None:
    time = np.arange(0.0, 2.0, 1 / rate)
    inside = slice(int(0.2 * rate), -int(0.2 * rate))
    values = 5.0 + 3.0 * time[:, None] ** 2
    assert blur(time, time, values)[2][inside] == pytest.approx(6.0, rel=1e-3)
