"""What is said rests on the fitted runs; the run that is held out is only checked."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig, diagnose, figures, load_case
from realsim.gap.answer.conclusion import _again, _fitted, _lasting, _told_from_none, beside_imitations
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.answer.leaveout import better, discrepancy, leave_out
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import leftover
from realsim.gap.inference.causes.score import gained, least_gain
from realsim.gap.inference.causes.select import Selection
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.simulate import Simulator

from .searching import fitting, logged
from .truth import Truth

EFFECTS = ("coulomb_friction", "viscous_friction", "stribeck_friction", "load_friction", "stiffness_gain")
CONFIG = DiagnoseConfig(threads=1, effects=EFFECTS, bootstrap=50, report=False)
PLAIN = replace(CONFIG, effects=("coulomb_friction", "viscous_friction"))


@pytest.fixture(scope="module")
def arm(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(), runs=4, span=(2.2, 2.6)))


@pytest.fixture(scope="module")
def sticky(arm: Case) -> Case:
    return logged(arm, [("coulomb_friction", ("shoulder",), {"friction": 3.0})])


@pytest.fixture(scope="module")
def fitter(sticky: Case) -> Iterator[Fitter]:
    with fitting(sticky, EFFECTS, [0, 1, 2]) as fitter:
        yield fitter


def cause(fitter: Fitter, effect: str, *values: float) -> Cause:
    found = next(
        c
        for c in fitter.screen.candidates
        if (c.effect, c.place) == (effect, ("shoulder",)) and len(c.names) == len(values)
    )
    return Cause(found, values)


def disturbed(case: Case, run: int, size: float) -> Case:
    """The case with slow errors and noise in one run's measurements."""
    runs = list(case.runs)
    rng = np.random.default_rng(0)
    slow = size * np.sin(3.0 * runs[run].time)[:, None]
    noisy = {k: v + slow + rng.normal(0, size, v.shape) for k, v in runs[run].signals.items() if k == "joint_pos"}
    runs[run] = replace(runs[run], signals=runs[run].signals | noisy)
    return case.with_runs(tuple(runs))


@pytest.fixture(scope="module")
def calm(sticky: Case) -> Diagnosis:
    return diagnose(sticky, PLAIN)


def test_the_run_held_out_changes_the_check_and_nothing_else(sticky: Case, calm: Diagnosis) -> None:
    loud = diagnose(disturbed(sticky, 3, 0.02), PLAIN)
    assert calm.shrinkage["runs"] == loud.shrinkage["runs"] == [sticky.runs[3].name]
    assert calm.shrinkage["kind"] == "validation"
    assert calm.causes == loud.causes
    assert calm.ranking == loud.ranking
    assert calm.statistics["left_out_over_floor"] == loud.statistics["left_out_over_floor"]
    assert calm.patch == loud.patch
    for signal, row in calm.shrinkage["per_signal"].items():
        assert row["floor"] == pytest.approx(loud.shrinkage["per_signal"][signal]["floor"], rel=0.05)
    assert loud.shrinkage["fraction"] < calm.shrinkage["fraction"]


def test_with_one_run_nothing_is_held_out_and_it_is_said(sticky: Case) -> None:
    found = diagnose(sticky.with_runs(sticky.runs[:1]), PLAIN)
    assert found.shrinkage["kind"] == "fitted"
    assert not found.shrinkage["unseen"]
    assert any("no run was held out" in w for w in found.health["warnings"])
    assert "no other was left" in found.sentence or found.verdict == "no_gap"


def test_a_search_that_is_cut_short_answers_with_what_it_has(sticky: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    late = [0.0]
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + late[0])
    monkeypatch.setattr("realsim.gap.simulation.simulate.time", clock)

    def progress(what: str, share: float) -> None:
        if what == "search for causes" and share > 0:  # the first cause was found, and others are looked for
            late[0] = 1e6

    found = diagnose(sticky, PLAIN, progress)
    assert [c["effect"] for c in found.causes] == ["coulomb_friction"]
    assert found.causes[0]["parameters"]["friction"]["value"] == pytest.approx(3.0, rel=0.1)
    assert found.verdict == "partly_explained"
    assert "cut short" in found.sentence
    assert "--time-limit" in found.advice
    assert found.statistics["cut_short"]


def test_a_time_limit_that_ends_before_the_first_slopes_says_where_the_gap_lies(sticky: Case) -> None:
    found = diagnose(sticky, replace(PLAIN, time_limit=1e-6))
    assert found.verdict == "unexplained"
    assert found.where[0]["joint"] == diagnose(sticky, PLAIN).where[0]["joint"]
    assert not found.causes
    assert found.lead is None
    assert "joint position" in found.sentence
    assert "cut short" in found.sentence
    assert "--time-limit" in found.advice
    assert "noise" in found.health


def test_no_probability_is_stated_that_was_not_calibrated(calm: Diagnosis) -> None:
    assert calm.causes
    assert [c["probability"] for c in calm.causes] == [None] * len(calm.causes)


def test_values_are_fitted_anew_without_each_run(fitter: Fitter) -> None:
    fit = fitter.fit([cause(fitter, "coulomb_friction", 2.0)])
    assert fit is not None
    left = leave_out(fitter, fit)
    assert left.values.shape == (3, 1)
    assert len(set(left.values[:, 0])) == 3
    assert left.values[:, 0] == pytest.approx(fit.causes[0].values[0], rel=0.1)
    assert left.after.mean() < 2.0
    gain, error = gained(leave_out(fitter, fitter.nominal()).after, left.after)
    assert gain > 3.0 > error


def test_a_model_that_stays_wrong_widens_its_intervals(arm: Case, sticky: Case) -> None:
    sigmas = []
    for size in (0.0, 0.02):
        case = sticky
        for run in range(3):
            case = disturbed(case, run, size)
        with Simulator(case, CONFIG) as simulator:
            nominal = simulator.simulate()
            comparison = Comparison(case, simulator.channels, nominal, CONFIG, [0, 1, 2])
            comparison.noise = replace(comparison.noise, sensor=np.full_like(comparison.noise.sensor, 1e-3))
            its = Fitter.of(Screen(simulator, comparison, [0, 1, 2], EFFECTS))
            fit = its.fit([cause(its, "coulomb_friction", 3.0)])
            assert fit is not None
            sigmas.append(float(leave_out(its, fit).sigmas[0]))
    assert sigmas[1] > 1.4 * sigmas[0]


def chosen(fitter: Fitter, fit: Fit) -> Selection:
    return Selection(fit, fitter.nominal(), [], [], {}, [], fitter)


def test_a_cause_that_left_out_runs_do_not_need_is_taken_out(fitter: Fitter) -> None:
    """A third cause of 0.3 N for 1.4 s stood beside two right ones on a real log."""
    both = fitter.fit([cause(fitter, "coulomb_friction", 3.0), cause(fitter, "viscous_friction", 0.001)], iterations=1)
    assert both is not None
    notes: list[str] = []
    fit, left, _ = _lasting(fitter, chosen(fitter, both), notes)
    assert [c.candidate.effect for c in fit.causes] == ["coulomb_friction"]
    assert left is not None
    assert "left-out runs do not need it" in notes[0]


def test_a_single_cause_is_left_to_the_check(fitter: Fitter) -> None:
    """Deviations imitate it on runs left out; a weaker calf, 2.5 times what a real leg's model leaves, was lost so."""
    wrong = fitter.looked_at(fitter.nominal(), [cause(fitter, "stiffness_gain", -1.5)])
    assert wrong is not None
    notes: list[str] = []
    fit, left, _ = _lasting(fitter, chosen(fitter, wrong), notes)
    assert fit is wrong
    assert left is not None
    assert not notes


def test_the_nearest_cause_is_told_from_none(fitter: Fitter) -> None:
    """A log without an error had a friction of 0.008 [-0.06, 0.008] N m s/rad as its nearest cause."""
    fit = fitter.looked_at(fitter.nominal(), [cause(fitter, "coulomb_friction", 3.0)])
    assert fit is not None
    assert any(_told_from_none(fit, np.array([1.8])))
    assert not any(_told_from_none(fit, np.array([1.9])))
    law = fitter.looked_at(fitter.nominal(), [cause(fitter, "stribeck_friction", 0.0, 3.0, 0.1)])
    assert law is not None
    assert any(_told_from_none(law, np.array([1.0, 1.0, 0.5])))


def test_a_law_without_its_own_part_is_no_rival(fitter: Fitter) -> None:
    """Stribeck friction whose static part is zero stood beside Coulomb friction as another explanation."""
    fit = fitter.looked_at(fitter.nominal(), [cause(fitter, "coulomb_friction", 3.0)])
    nothing = fitter.looked_at(fitter.nominal(), [cause(fitter, "stribeck_friction", 0.0, 3.0, 0.1)])
    other = fitter.looked_at(fitter.nominal(), [cause(fitter, "viscous_friction", 1.0)])
    assert fit is not None
    assert nothing is not None
    assert other is not None
    assert _again(fitter.screen, nothing, fit)
    assert not _again(fitter.screen, other, fit)


def test_the_same_value_at_a_further_joint_is_no_rival(fitter: Fitter) -> None:
    """A torque limit at a shoulder was `ambiguous` beside the same limit at an elbow, too, which never came near it."""
    alone = cause(fitter, "coulomb_friction", 3.0)
    wide = next(
        c for c in fitter.screen.candidates if c.effect == "coulomb_friction" and set(c.place) == {"shoulder", "elbow"}
    )
    fit = fitter.looked_at(fitter.nominal(), [alone])
    same, less = (fitter.looked_at(fitter.nominal(), [Cause(wide, (value,))]) for value in (3.02, 1.5))
    assert fit is not None
    assert same is not None
    assert less is not None
    fit = fitter.spread(fit)
    assert _again(fitter.screen, same, fit)
    assert not _again(fitter.screen, less, fit)  # at both joints it is another size
    assert not _again(fitter.screen, fit, same)  # the further joint would go unnamed


def test_a_weaker_servo_is_compared_with_load_friction(arm: Case) -> None:
    """Holding or lifting, friction of r times the torque looks like kp / (1 + r): two real cases were called so."""
    weak = logged(arm, [("stiffness_gain", ("shoulder",), {"ratio": -0.25})])
    with fitting(weak, EFFECTS, [0, 1, 2]) as its:
        fit = its.fit([cause(its, "load_friction", 0.28)])
        assert fit is not None
        notes: list[str] = []
        found, _, others = beside_imitations(its, fit, leave_out(its, fit), [], notes)
    named = [c.candidate.effect for f in (found, *others) for c in f.causes]
    assert "stiffness_gain" in named
    assert found.causes[0].candidate.effect == "stiffness_gain"


@pytest.mark.parametrize("name", ["offset", "reading_offset"])
def test_an_encoder_s_zero_is_compared_with_play(arm: Case, name: str) -> None:
    """Play in a quadruped's calf and thigh, whose load seldom changes sign, was `identified` as its encoder's zero."""
    loose = logged(arm, [("backlash", ("shoulder",), {"gap": 0.03})])
    with fitting(loose, ("backlash", "joint_offset"), [0, 1, 2]) as its:
        zero = next(c for c in its.screen.candidates if c.names == (name,) and c.place == ("shoulder",))
        fit = its.fit([Cause(zero, (0.015,))])
        assert fit is not None
        found, _, others = beside_imitations(its, fit, leave_out(its, fit), [], [])
    assert "backlash" in [c.candidate.effect for f in (found, *others) for c in f.causes]


def test_what_is_better_is_better_by_more_than_its_scatter(fitter: Fitter) -> None:
    screen, runs = fitter.screen, [0, 1, 2]
    nominal = [screen.comparison.residual(r, y) for r, y in zip(runs, screen.nominal, strict=True)]
    half = [0.5 * r for r in nominal]
    gain, error = better(screen.comparison, runs, half, nominal)
    assert gain > 3 * error > 0
    assert better(screen.comparison, runs, nominal, nominal) == (0.0, 0.0)
    assert (discrepancy(screen.comparison, runs, half) <= discrepancy(screen.comparison, runs, nominal)).all()


def test_what_stays_is_judged_with_one_set_of_deviations_for_all_runs(
    fitter: Fitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Deviations that explain the first run, and a half of the others."""
    screen, fit = fitter.screen, fitter.nominal()
    gap = [screen.comparison.residual(run, y) for run, y in zip(screen.runs, fit.predictions, strict=True)]
    simulated = [
        np.nanmean(r**2 / screen.comparison.tolerance(run, fit.conditions.weights))
        for run, r in zip(screen.runs, gap, strict=True)
    ]
    monkeypatch.setattr(screen, "fitted", lambda k, x: gap[k] * (1.0 if k == 0 else 0.5))
    assert leftover(screen, fit) == pytest.approx([0.0, *(s / 4 for s in simulated[1:])])


def test_what_stays_is_a_share_of_what_deviations_alone_leave(fitter: Fitter) -> None:
    nothing, whole = fitter.nominal(), fitter.fit([cause(fitter, "coulomb_friction", 3.0)])
    weak = fitter.looked_at(nothing, [cause(fitter, "coulomb_friction", 0.3)])
    assert whole is not None
    assert weak is not None
    shares = [_fitted(fitter.screen, f, nothing, fitter.screen.nominal).share for f in (nothing, weak, whole)]
    assert shares[0] == pytest.approx(1.0)
    assert 0.6 < shares[1] < 1.0
    assert shares[2] < 0.05


def test_noise_asks_nothing_of_a_further_cause(fitter: Fitter) -> None:
    """A longer log has more noise to be fitted; a cause need not remove a share of that, nor the first one of a gap."""
    nothing, whole = fitter.nominal(), fitter.fit([cause(fitter, "coulomb_friction", 3.0)])
    part = fitter.looked_at(nothing, [cause(fitter, "coulomb_friction", 0.3)])
    assert whole is not None
    assert part is not None
    assert least_gain(fitter, whole) == least_gain(fitter, nothing) == figures.CLEARLY
    assert least_gain(fitter, part) > max(figures.CLEARLY, 0.8 * figures.SHARE * part.misfit)
