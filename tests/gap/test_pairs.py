"""Two causes of which neither is what looks best alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.causes.fit import Cause, Fitter
from realsim.gap.causes.forward import sharpened, straightened
from realsim.gap.causes.pairs import better_pair, joint_pair
from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged
from .truth import PENDULUM, Truth

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


def test_two_causes_of_which_neither_does_alone_are_tried_together(fitter: Fitter) -> None:
    nominal = fitter.nominal()
    first = [
        _alone(fitter, "motor_gain", -0.2),
        _alone(fitter, "stiffness_gain", -0.3),
        _alone(fitter, "armature", 0.05),
    ]
    found = joint_pair(fitter.screen, fitter, nominal, first, [])
    assert found is not None
    alone, pairs = found
    assert {c.candidate.effect for c in pairs[0].causes} == {"stiffness_gain", "armature"}
    assert all(alone.causes[0].candidate.key in [c.candidate.key for c in p.causes] for p in pairs)


def test_a_late_command_beside_a_weak_damper_is_found_with_it(made) -> None:
    """Each alone swings otherwise than both, so that neither explains much of the gap by itself."""
    nominal = load_case(made("pairs_pendulum", Truth(), xml=PENDULUM, runs=4))
    case = logged(nominal, [("damping_gain", ("swing",), {"ratio": -0.7}), ("command_delay", (), {"delay": 0.03})])
    found = diagnose(case, replace(CONFIG, bootstrap=20, report=False))
    sets = [found.causes, *found.equivalent]
    assert any({c["effect"] for c in s} == {"damping_gain", "command_delay"} for s in sets)


def test_deviations_that_imitated_a_cause_are_set_straight_beside_it(made) -> None:
    nominal = load_case(made("pairs", Truth(), runs=3))
    with Simulator(nominal, CONFIG) as simulator:
        place = (simulator.context.driven[0],)
    case = logged(nominal, [("stiffness_gain", place, {"ratio": -0.3})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        fitter = Fitter(Screen(simulator, comparison, range(len(case.runs)), ("stiffness_gain", "armature")))
        assert straightened(fitter, fit := _alone(fitter, "stiffness_gain", -0.2)) is fit  # nothing is bent
        i = fitter.screen.index["armature", place, "armature"]
        fitter.about[i] = 3 * fitter.screen.prior[i]
        straight = straightened(fitter, _alone(fitter, "stiffness_gain", -0.2))
    assert not straight.about[i]
    assert straight.causes[0].values[0] == pytest.approx(-0.3, abs=0.01)
