"""Noise is read off the finite samples of a column, whatever the log's rate; full columns as ever."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.case.health.signals import noise
from realsim.gap.case.motion import differences, median_size
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.start import _noise

from .truth import Truth

CONFIG = DiagnoseConfig(threads=1)


@pytest.mark.parametrize(("order", "weights"), [(2, [1, -2, 1]), (3, [1, -3, 3, -1])])
@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_full_columns_are_differenced_row_by_row(order: int, weights: list[int], lost: float) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=500)
    x[rng.random(500) < lost] = np.nan
    plain = np.convolve(x, weights, "valid")
    np.testing.assert_allclose(differences(x, order), plain[np.isfinite(plain)], atol=1e-14)


@pytest.mark.parametrize("column", [np.zeros(0), np.ones(2), np.full(9, np.nan)])
def test_what_has_no_differences_has_no_noise(column: np.ndarray) -> None:
    assert median_size(differences(column, 2)) == 0
    assert median_size(differences(column, 3)) == 0


def halved(case: Case) -> Case:
    """Velocities at half the log's rate, joint by joint in other rows."""
    runs = []
    for run in case.runs:
        speed = run.signals["joint_vel"].copy()
        speed[::2, 0], speed[1::2, 1] = np.nan, np.nan
        runs.append(replace(run, signals=run.signals | {"joint_vel": speed}))
    return case.with_runs(tuple(runs))


def test_a_signal_at_half_the_rate_of_the_log_has_its_noise(made: Callable[..., Path]) -> None:
    """What the truth adds to velocities: 0.02 rad/s."""
    case = halved(load_case(made(Truth())))
    with Simulator(case, CONFIG) as simulator:
        nominal = simulator.simulate()
        floor = Comparison(case, simulator.channels, nominal, CONFIG).noise.sensor
        figures, _ = noise(simulator, nominal)
        columns = [i for i, c in enumerate(simulator.channels) if c.signal == "joint_vel"]
    assert floor[columns] == pytest.approx(0.02, rel=0.4)
    assert figures["joint_vel"]["sample"] == pytest.approx(0.02, rel=0.4)
    assert np.all(_noise(case.runs[0].signals["joint_vel"]) > 0.01)
