"""Derivatives of a log."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.core.filters import low_passed
from realsim.gap import load_case
from realsim.gap.case.motion import blur, smooth, velocity_lag

from .truth import Truth


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


@pytest.mark.parametrize("lag", [0.0, 0.01, 0.02, 0.05])
def test_a_filter_of_velocities_is_measured_by_the_positions(made: Callable[..., Path], lag: float) -> None:
    case = load_case(made(Truth()))
    runs = [
        replace(
            run, signals=run.signals | {"joint_vel": low_passed(np.nan_to_num(run.signals["joint_vel"]), lag, 0.008)}
        )
        for run in case.runs
    ]
    assert velocity_lag(case.with_runs(tuple(runs))) == pytest.approx(lag, abs=0.003)


def test_a_filter_of_first_order_goes_63_percent_of_a_step_in_its_time_constant() -> None:
    step = np.concatenate([np.zeros(1), np.ones(400)])[:, None]
    assert low_passed(step, 0.1, 0.001)[100, 0] == pytest.approx(1 - np.exp(-1), abs=0.005)
    assert low_passed(step, 0.0, 0.001) == pytest.approx(step)
