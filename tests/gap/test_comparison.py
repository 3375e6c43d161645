"""Weights of a comparison: white noise counts sample by sample, slow structure by how long it is correlated."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.inference.likelihood.comparison import CORRELATION, Comparison, correlated
from realsim.gap.simulation.simulate import Simulator, measured

from .truth import Truth


def test_white_noise_counts_sample_by_sample(made: Callable[..., Path]) -> None:
    case = load_case(made(Truth()))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        still = [np.zeros((len(r.time), len(simulator.channels))) for r in case.runs]
        comparison = Comparison(case, simulator.channels, still, DiagnoseConfig(threads=1))
        weights = comparison.weights([np.zeros(len(simulator.channels))] * len(case.runs))
        found = sum(float((w * comparison.noise.sensor**2).sum()) for w in weights.of)
    samples = sum(np.isfinite(measured(run, simulator.channels)).sum() for run in case.runs)
    assert found == pytest.approx(samples)


def test_correlated_noise_counts_as_in_the_known_formula() -> None:
    """(1 + rho) / (1 - rho) samples of a first-order autoregression count as one, in the long run."""
    assert correlated(5000) == CORRELATION
    assert correlated(399) == pytest.approx(CORRELATION, rel=0.15)
    sizes = [correlated(n) for n in range(3, 399, 12)]
    assert all(a <= b for a, b in pairwise(sizes))


def test_a_free_start_takes_slow_structure_over() -> None:
    rng, bins, rho = np.random.default_rng(0), 25, (CORRELATION - 1) / (CORRELATION + 1)
    noise = rng.normal(size=(20_000, bins))
    for k in range(1, bins):
        noise[:, k] = rho * noise[:, k - 1] + np.sqrt(1 - rho**2) * noise[:, k]
    t = np.arange(bins) / bins
    basis = np.stack([t**2, t, np.ones(bins)], axis=1)
    white = np.linalg.inv(basis.T @ basis)[0, 0]
    found = np.var(noise @ np.linalg.pinv(basis)[0]) / white
    assert correlated(bins) == pytest.approx(found, rel=0.05)
