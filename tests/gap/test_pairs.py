"""Two causes of which neither is what looks best alone."""

from __future__ import annotations

import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.causes.fit import Cause, Fitter
from realsim.gap.causes.pairs import better_pair
from realsim.gap.causes.screen import Screen
from realsim.gap.causes.select import sharpened
from realsim.gap.compare import Comparison
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged
from .truth import Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)


@pytest.fixture(scope="module")
def fitter(made):
    """A log with a softer servo and a heavier rotor at one joint."""
    nominal = load_case(made("pairs", Truth(), runs=3))
    with Simulator(nominal, CONFIG) as simulator:
        joint = simulator.context.driven[0]
        armature = 1.5 * simulator.context.inertia[joint]
    causes = [("stiffness_gain", (joint,), {"ratio": -0.3}), ("armature", (joint,), {"armature": armature})]
    case = logged(nominal, causes)
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        names = ("stiffness_gain", "armature", "damping_gain", "motor_gain")
        yield Fitter(Screen(simulator, comparison, range(len(case.runs)), names))


def _alone(fitter: Fitter, effect: str, value: float):
    candidate = next(c for c in fitter.screen.candidates if c.effect == effect and len(c.places) == 1)
    fit = fitter.fit([Cause(candidate, (value,))])
    assert fit is not None
    return fit


def test_the_true_pair_replaces_a_winner_that_imitates_it(fitter: Fitter) -> None:
    nominal = fitter.nominal()
    winner = _alone(fitter, "damping_gain", 0.3)
    first = [winner, _alone(fitter, "stiffness_gain", -0.3), _alone(fitter, "armature", 0.05)]
    found = better_pair(fitter.screen, fitter, nominal, winner, first, [], [])
    assert found is not None
    assert {c.candidate.effect for c in found[1][0].causes} == {"stiffness_gain", "armature"}


def test_weights_are_only_sharpened_beside_a_cause(fitter: Fitter) -> None:
    comparison = fitter.screen.comparison
    before = [w.copy() for w in comparison.weights]
    sharpened(fitter.screen, fitter, fitter.nominal())
    assert all(np.array_equal(a, b) for a, b in zip(before, comparison.weights, strict=True))
    fit = _alone(fitter, "stiffness_gain", -0.3)
    sharpened(fitter.screen, fitter, fit)
    assert all((b >= a).all() for a, b in zip(before, comparison.weights, strict=True))
