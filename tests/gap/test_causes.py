"""The search over sets of causes: its score, its moves, and what it may look at."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import Case, load_case
from realsim.gap.answer.diagnosis import ranked_effects
from realsim.gap.effects import EFFECTS
from realsim.gap.figures import CLEARLY, PRICE
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import Trial, leftover
from realsim.gap.inference.causes.proposals import ADD, EXCHANGE, Propose, ranked
from realsim.gap.inference.causes.score import doubts, left_out, score
from realsim.gap.inference.causes.search import Search
from realsim.gap.inference.causes.select import Selection, select
from realsim.gap.inference.likelihood.linear import Evidence, bounded
from realsim.gap.simulation.simulate import Simulator

from .searching import CONFIG, fitting, logged
from .truth import PENDULUM, Truth

PAIR = ("stiffness_gain", "armature", "damping_gain", "motor_gain")


def searched(case: Case, runs: list[int], effects: tuple[str, ...] = ()) -> Selection:
    with fitting(case, effects, runs) as fitter:
        return select(fitter, CONFIG)


def found(selection: Selection) -> list[set[str]]:
    """Effects of the best set, and of those that explain the runs alike."""
    return [{c.candidate.effect for c in f.causes} for f in (selection.fit, *selection.equivalent)]


@pytest.fixture(scope="module")
def pair(made) -> Case:
    """A softer servo and a heavier rotor at the same joint."""
    nominal = load_case(made(Truth(), runs=3))
    with Simulator(nominal, CONFIG) as simulator:
        joint = simulator.context.driven[0]
        armature = 1.5 * simulator.context.inertia[joint]
    return logged(
        nominal, [("stiffness_gain", (joint,), {"ratio": -0.3}), ("armature", (joint,), {"armature": armature})]
    )


@pytest.fixture(scope="module")
def fitter(pair: Case):
    with fitting(pair, (*PAIR, "link_inertia")) as fitter:
        yield fitter


def fit(fitter: Fitter, **values: float) -> Fit:
    """Causes at the first joint, fitted from these values."""
    first = fitter.screen.simulator.context.driven[0]
    by_effect = {c.effect: c for c in fitter.screen.candidates if c.place == (first,)}
    result = fitter.fit([Cause(by_effect[effect], (value,)) for effect, value in values.items()])
    assert result is not None
    return result


def test_runs_whose_slopes_hold_for_nothing_do_not_hide_what_the_others_show(fitter: Fitter) -> None:
    """A foot slips in a run and in its repeat: there a cause's slope is steep and has nothing to do with the error."""
    nominal = fitter.nominal()
    first = fitter.screen.simulator.context.driven[0]
    gain, soft, _ = next(r for r in ranked(fitter.screen, nominal) if r[1].key[:2] == ("stiffness_gain", (first,)))
    steep, e = 1e6 * soft.directions @ soft.directions.T, nominal.evidence
    twice = [e.A[2] + steep] * 2, [0 * e.b[2]] * 2, [1e3 * max(e.c)] * 2
    slipped = Evidence([*e.A, *twice[0]], [*e.b, *twice[1]], [*e.c, *twice[2]], runs=(*e.runs, *e.runs[:2]))
    assert slipped.looks()[1].runs == e.runs
    there = next(g for g, c, _ in ranked(fitter.screen, replace(nominal, evidence=slipped)) if c.key == soft.key)
    assert there >= 0.9 * gain > 0


def test_a_set_that_the_search_comes_back_to_may_still_get_another_cause(fitter: Fitter, monkeypatch) -> None:
    """An exchange may lead to the same causes at better values, beside which another one helps."""
    search, tried = Search(fitter, 2, fitter.nominal()), list[Sequence[Propose]]()

    def moved(moves: Sequence[Propose]) -> bool:
        tried.append(moves)
        return tried == [EXCHANGE]

    monkeypatch.setattr(search, "_moved", moved)
    search.run(lambda what, share: None)
    assert tried == [EXCHANGE, ADD]


@pytest.mark.slow
def test_a_late_command_beside_a_weak_damper_is_found_with_it(made) -> None:
    """Each alone swings otherwise than both, so that neither explains much of the gap by itself."""
    nominal = load_case(made(Truth(), xml=PENDULUM, runs=3))
    case = logged(nominal, [("damping_gain", ("swing",), {"ratio": -0.7}), ("command_delay", (), {"delay": 0.03})])
    rivals = ("damping_gain", "command_delay", "armature", "stiffness_gain")
    assert {"damping_gain", "command_delay"} in found(searched(case, [0, 1, 2], rivals))


def test_nuisance_parameters_that_imitate_a_cause_do_not_make_it_smaller(made) -> None:
    nominal = load_case(made(Truth(), xml=PENDULUM, runs=3))
    case = logged(nominal, [("com_offset", ("arm",), {"z": 0.02})])
    best = searched(case, [0, 1, 2], ("com_offset", "armature", "coulomb_friction")).fit
    (cause,) = best.causes
    assert cause.candidate.effect == "com_offset"
    assert cause.named["z"] == pytest.approx(0.02, rel=0.05)


def test_a_run_that_is_not_fitted_changes_nothing(pair: Case) -> None:
    other = pair.runs[2]
    noise = {"joint_pos": other.signals["joint_pos"] + 0.5 * np.sin(40 * other.time)[:, None]}
    changed = pair.with_runs((*pair.runs[:2], replace(other, signals=other.signals | noise)))
    one, two = (searched(case, [0, 1], PAIR[:1]).fit for case in (pair, changed))
    assert [c.candidate.key for c in one.causes] == [c.candidate.key for c in two.causes]
    assert one.misfit == pytest.approx(two.misfit, rel=1e-9)
    assert [c.values for c in one.causes] == [pytest.approx(c.values, rel=1e-9) for c in two.causes]


def test_of_a_single_run_none_is_left_out_and_that_is_said(pair: Case) -> None:
    selection = searched(pair, [0], PAIR[:1])
    assert selection.fit.causes
    assert any("a single run" in note for note in selection.notes)


def test_a_run_is_left_out_with_values_that_are_fitted_to_the_others(fitter: Fitter, pair: Case) -> None:
    """One step from the values that suit all runs is as good as a fit to the others."""
    all_runs = fit(fitter, stiffness_gain=-0.3)
    with fitting(pair, (*PAIR, "link_inertia"), [1, 2]) as few:
        others = few.fit(all_runs.causes, iterations=8)
        assert others is not None
        whole = fitter.looked_at(all_runs, others.causes)
    assert whole is not None
    e, x = whole.evidence, within_bounds(others)
    direct = 0.5 * float(e.c[0] - 2 * e.b[0] @ x + x @ e.A[0] @ x)
    assert fitter.left_out(all_runs)[0] == pytest.approx(direct, rel=0.1)


def test_a_run_is_left_out_beside_the_deviations_of_its_fit(fitter: Fitter) -> None:
    """A fit stays what it was where the search has since moved the deviations that it simulates."""
    soft = fit(fitter, stiffness_gain=-0.3)
    before = fitter.left_out(soft)
    about = [0.1 * (a.effect == "link_inertia") for a in fitter.screen.atoms]
    moved = fitter.under(about=np.array(about))
    assert moved.left_out(soft) == pytest.approx(before)
    assert moved.remeasure(soft).misfit == pytest.approx(soft.misfit)


def test_a_force_that_is_over_as_the_run_begins_is_no_cause(made) -> None:
    """A quadruped's turned encoder was named with a force of the first 0.07 s beside it: there a run's start shows."""
    kick = ("external_force", ("fore",), {"fx": 40.0, "fz": 0.0, "start": -0.1})
    said = []
    for end in (0.06, 1.0):
        case = logged(load_case(made(Truth(), runs=3)), [(*kick[:2], kick[2] | {"end": end})])
        with fitting(case, ("external_force",), [0, 1, 2]) as fitter:
            push = next(c for c in fitter.screen.candidates if c.names == ("fx", "fz") and c.place == ("fore",))
            every = {
                p.name: p for p in EFFECTS["external_force"].parameters(fitter.screen.simulator.context, ("fore",))
            }
            push = replace(push, parameters=tuple(every[n] for n in ("fx", "fz", "start", "end")))
            found = fitter.fit([Cause(push, (40.0, 0.0, -0.1, end))])
            assert found is not None
            said.append(any("of its start" in d for d in doubts(fitter, fitter.nominal(), found)[0]))
    assert said == [True, False]


def within_bounds(fit: Fit) -> np.ndarray:
    """(p,) the most probable deviations beside a fit, none beyond three standard deviations."""
    A, b = np.sum(fit.evidence.A, axis=0), np.sum(fit.evidence.b, axis=0)
    return bounded(A, b, fit.prior, 3 * fit.prior)[0]


def test_deviations_that_would_imitate_a_cause_leave_a_gap(fitter: Fitter) -> None:
    """They are cut off where they are no longer everyday; to be compared, each set makes the best of that."""
    nothing, both = fitter.nominal(), fit(fitter, stiffness_gain=-0.3, armature=0.1)
    screen = fitter.screen
    assert leftover(screen, nothing).mean() > 20 * leftover(screen, both).mean()
    assert not fitter.with_deviations(nothing).about.any()
    within = within_bounds(nothing)
    assert np.all(np.abs(within) <= 3 * nothing.prior * (1 + 1e-9))


def test_the_search_ends_where_no_set_could_be_named(fitter: Fitter) -> None:
    nothing, soft = fitter.nominal(), fit(fitter, stiffness_gain=-0.3)
    search = Search(fitter, 3, nothing)
    assert not search._hopeless(np.full(3, 101.0))
    search.best = soft
    assert search._hopeless(np.full(3, 91.0))  # three causes as good as this one leave 73 % of the gap
    assert not search._hopeless(np.full(3, 81.0))  # or 51 %
    search.most = 1
    assert search._hopeless(np.full(3, 81.0))


def test_a_cause_in_the_place_of_another_one_is_ranked_by_what_it_gains_itself(fitter: Fitter) -> None:
    nothing, soft, rotor = fitter.nominal(), fit(fitter, stiffness_gain=-0.3), fit(fitter, armature=0.05)
    (first,), (better,) = soft.causes, rotor.causes
    search = Search(fitter, 1, soft)
    poor = Trial(better.candidate, 0, 9.0, "does not hold", -5.0, held=(-1.0, 1.0))
    search.trials = [poor, Trial(first.candidate, 0, 1.0, "accepted", nothing.misfit - soft.misfit, held=(9.0, 1.0))]
    assert search._better(soft, [rotor])
    ranking = ranked_effects(Selection(rotor, nothing, search.trials, [], {}, [], fitter), fitter.screen)
    row = next(r for r in ranking if r["effect"] == "armature")
    assert (row["outcome"], row["linear_gain"]) == ("accepted", 9.0)
    assert row["gain"] == pytest.approx(nothing.misfit - rotor.misfit)
    assert ranking[0] == row


def test_the_score_prefers_fewer_causes_fewer_places_and_usual_effects(fitter: Fitter) -> None:
    screen = fitter.screen
    rotor = fit(fitter, armature=0.05)
    other = next(c for c in screen.candidates if c.effect == "link_inertia" and len(c.names) == 1)
    link = fitter.looked_at(rotor, [Cause(other, (0.1,))])
    assert link is not None
    known = np.zeros((1, 1))
    rare = score(fitter, replace(link, misfit=rotor.misfit, covariance=known))
    assert rare == pytest.approx(score(fitter, replace(rotor, covariance=known)) + PRICE)
    both = fit(fitter, stiffness_gain=-0.3, armature=0.05)
    less = fit(fitter, stiffness_gain=-0.3)
    assert score(fitter, replace(less, misfit=both.misfit)) < score(fitter, both) - CLEARLY
    assert score(fitter, both) < score(fitter, less)


def test_a_further_cause_needs_runs_that_are_left_out(fitter: Fitter, monkeypatch: pytest.MonkeyPatch) -> None:
    less, both = fit(fitter, stiffness_gain=-0.3), fit(fitter, stiffness_gain=-0.3, armature=0.05)
    assert doubts(fitter, less, both)[0] == []
    assert left_out(fitter, less, both) is not None
    monkeypatch.setattr("realsim.gap.inference.causes.score.left_out", lambda *_: (-5.0, 1.0))
    assert doubts(fitter, less, both)[0] == ["does not hold on runs left out in turn"]
