"""The experimental selection: laws of its score, of the posterior over sets, of the verdict; and one log end to end."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.compare import Comparison
from realsim.gap.effects.base import Parameter
from realsim.gap.selection.engine import answer
from realsim.gap.selection.fitting import log_prior, log_prior_slope, sandwich
from realsim.gap.selection.likelihood import Likelihood
from realsim.gap.selection.select import posterior
from realsim.gap.selection.verdict import Check, Verdict, judge
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged
from .truth import Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3, effects=("coulomb_friction", "armature"))
STEP = Parameter("friction", "N m", (-1.0, 10.0), 0.2)


def fit(*slots: tuple[str, str], evidence: float) -> SimpleNamespace:
    named = frozenset((effect, (place,)) for effect, place in slots)
    return SimpleNamespace(causes=tuple(slots), named=named, evidence=evidence)


def over(*fits: SimpleNamespace):
    """A posterior over these sets, with 100 places at which a cause can be."""
    places = [SimpleNamespace(effect="e", place=(str(i),)) for i in range(100)]
    fitter = SimpleNamespace(screen=SimpleNamespace(candidates=places))
    return posterior(fitter, list(fits), fits[0], {}, [])


@given(st.floats(-5, 5))
def test_the_slope_of_the_prior_is_that_of_its_density(z: float) -> None:
    h = 1e-5
    slope, curvature = log_prior_slope(np.array([z]), [STEP])
    numeric = (log_prior(np.array([z + h]), [STEP]) - log_prior(np.array([z - h]), [STEP])) / (2 * h)
    assert slope[0] == pytest.approx(numeric, abs=1e-4)
    assert curvature[0] > 0


def test_runs_that_agree_leave_the_models_covariance_and_runs_that_do_not_widen_it() -> None:
    hessian = np.array([[4.0, 1.0], [1.0, 3.0]])
    alike = sandwich(hessian, np.ones((4, 2)))
    apart = sandwich(hessian, 10 * np.array([[1.0, 1], [-1, -1], [1, 1], [-1, -1]]))
    assert alike == pytest.approx(np.linalg.inv(hessian))
    assert (np.diag(apart) > np.diag(alike)).all()


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=6))
def test_probabilities_of_sets_sum_to_one_and_fall(evidences: list[float]) -> None:
    found = over(*(fit(("e", str(i)), evidence=e) for i, e in enumerate(evidences)))
    assert sum(found.probabilities) == pytest.approx(1.0)
    assert found.probabilities == sorted(found.probabilities, reverse=True)


def test_a_cause_must_earn_its_prior_odds() -> None:
    nothing = fit(evidence=0.0)
    assert not over(nothing, fit(("e", "a"), evidence=np.log(100) - 1)).fits[0].causes
    assert over(nothing, fit(("e", "a"), evidence=np.log(100) + 1)).fits[0].causes


def test_fits_of_one_set_count_together() -> None:
    found = over(fit(("e", "a"), evidence=1.0), fit(("e", "a"), evidence=1.0), fit(("e", "b"), evidence=1.0))
    assert len(found.fits) == 2
    assert found.probabilities == pytest.approx([2 / 3, 1 / 3])


def checked(before: float, after: float) -> list[Check]:
    return [Check("joint_pos", 1.0, before, after, 1.0)]


@pytest.mark.parametrize(
    ("fits", "before", "after", "ends", "verdict"),
    [
        ((fit(evidence=0.0),), 1.0, 1.0, (), Verdict.NO_GAP),
        ((fit(evidence=0.0), fit(("e", "a"), evidence=50.0)), 9.0, 1.0, (), Verdict.IDENTIFIED),
        ((fit(("e", "a"), evidence=50.0), fit(("e", "b"), evidence=50.0)), 9.0, 1.0, (), Verdict.AMBIGUOUS),
        ((fit(evidence=0.0), fit(("e", "a"), evidence=50.0)), 9.0, 4.0, (), Verdict.PARTLY_EXPLAINED),
        ((fit(evidence=0.0), fit(("e", "a"), evidence=50.0)), 9.0, 8.0, (), Verdict.UNEXPLAINED),
        ((fit(evidence=0.0), fit(("e", "a"), evidence=50.0)), 9.0, 1.0, ("friction",), Verdict.UNEXPLAINED),
        ((fit(evidence=0.0),), 9.0, 9.0, (), Verdict.UNEXPLAINED),
    ],
)
def test_the_verdict_follows_from_the_posterior_and_the_unseen_run(fits, before, after, ends, verdict) -> None:
    assert judge(over(*fits), checked(before, after), ends).verdict == verdict


def test_alternatives_that_contain_the_best_set_are_not_alternatives() -> None:
    best, more = fit(("e", "a"), evidence=10.0), fit(("e", "a"), ("e", "b"), evidence=10.0 + np.log(100))
    other = fit(("e", "c"), evidence=10.0)
    named = [f.named for f in judge(over(best, more, other), checked(9.0, 1.0), ()).alternatives]
    assert named == [other.named]


@pytest.fixture(scope="module")
def case(made):
    return load_case(made("selection", Truth(), runs=3))


def test_the_score_knows_deviations_that_it_is_shown(case) -> None:
    """A residual made of a column is explained by it; one that is noise alone is not."""
    from realsim.gap.causes.screen import Screen

    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG, [0, 1])
        screen = Screen(simulator, comparison, [0, 1], CONFIG.effects)
    likelihood = Likelihood(screen, comparison)
    truth = 2.0 * screen.prior * (np.arange(len(screen.prior)) == 0)
    rows = [likelihood.columns[k] @ truth for k in likelihood.positions]
    found = likelihood.marginal(likelihood.moments(rows), screen.prior)
    nothing = likelihood.marginal(likelihood.moments([0 * r for r in rows]), screen.prior)
    assert nothing.x == pytest.approx(0)
    assert nothing.value >= found.value
    left = sum(float(np.sum((r - likelihood.columns[k] @ found.x) ** 2)) for k, r in zip((0, 1), rows, strict=True))
    assert left < sum(float(np.sum(r**2)) for r in rows)


def test_the_floor_is_not_read_off_a_run_that_is_held_out(case) -> None:
    with Simulator(case, CONFIG) as simulator:
        nominal = simulator.simulate()
        louder = list(case.runs)
        noise = np.random.default_rng(0).normal(0, 0.1, louder[2].signals["joint_pos"].shape)
        signals = louder[2].signals | {"joint_pos": louder[2].signals["joint_pos"] + noise}
        louder[2] = type(louder[2])(**{**vars(louder[2]), "signals": signals})
        floors = [
            Comparison(c, simulator.channels, nominal, CONFIG, [0, 1]).noise.sensor
            for c in (case, case.with_runs(tuple(louder)))
        ]
    assert floors[0] == pytest.approx(floors[1])


def test_friction_is_found_and_none_is_not(case) -> None:
    joint = case.joint_names[0]
    found = answer(logged(case, [("coulomb_friction", (joint,), {"friction": 2.0})]), CONFIG)
    assert (found["causes"][0]["effect"], found["causes"][0]["joints"]) == ("coulomb_friction", [joint])
    assert found["verdict"] in (Verdict.IDENTIFIED, Verdict.AMBIGUOUS)
    assert answer(logged(case, []), CONFIG)["verdict"] == Verdict.NO_GAP
