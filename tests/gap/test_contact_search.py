"""The search where feet slip and land: slopes say little, the misfit is jagged, small deviations imitate a cause."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import EFFECTS, Case
from realsim.gap.inference.causes.fit import Cause, Fit, Fitter
from realsim.gap.inference.causes.fitted import deviations, is_gap, leftover
from realsim.gap.inference.causes.proposals import by_simulation
from realsim.gap.inference.causes.search import Search, second_look
from realsim.gap.inference.likelihood.screen import Candidate

from .searching import fitting, logged

pytestmark = pytest.mark.slow


def candidate(fitter: Fitter, effect: str, *place: str) -> Candidate:
    return next(c for c in fitter.screen.candidates if c.effect == effect and c.place == place)


def at(fitter: Fitter, effect: str, place: str, value: float) -> Fit:
    fit = fitter.looked_at(fitter.nominal(), [Cause(candidate(fitter, effect, place), (value,))])
    assert fit is not None
    return fit


def test_causes_and_deviations_are_settled_together_and_nothing_else_moves(settled: Case) -> None:
    weaker = [("motor_gain", (j,), {"ratio": 0.04}) for j in ("fl_thigh", "hr_calf")]
    cause = ("coulomb_friction", ("fl_calf",), {"friction": 1.0})
    case = logged(settled, [cause, *weaker])
    with fitting(case, ("coulomb_friction", "motor_gain")) as fitter:
        before = at(fitter, "coulomb_friction", "fl_calf", 0.8)
        after = fitter.settled(before)
        assert after.about.any()
        assert after.misfit < before.misfit
        assert 0.8 < after.causes[0].values[0] < 1.1


def test_deviations_move_by_part_of_a_step_that_goes_too_far(settled: Case, monkeypatch) -> None:
    """Slopes of feet that land may overshoot: here by a factor of three."""
    weaker = [("motor_gain", (j,), {"ratio": 0.04}) for j in ("fl_thigh", "hr_calf")]
    case = logged(settled, weaker)
    with fitting(case, ("motor_gain",)) as fitter:
        before = fitter.nominal()
        monkeypatch.setattr(
            "realsim.gap.inference.causes.fit.deviations", lambda screen, fit: 3 * deviations(screen, fit)
        )
        after = fitter.beside_own(before)
        assert fitter._cost(after) < 0.5 * fitter._cost(before)


def test_a_set_may_have_the_deviations_that_its_neighbours_found(settled: Case, monkeypatch) -> None:
    """Else a cause that does nothing gains what only other deviations do."""
    weaker = [("motor_gain", (j,), {"ratio": 0.04}) for j in ("fl_thigh", "hr_calf")]
    case = logged(settled, weaker)
    with fitting(case, ("coulomb_friction", "motor_gain")) as fitter:
        nothing, idle = fitter.nominal(), at(fitter, "coulomb_friction", "fl_calf", 0.0)
        lucky = fitter.beside_own(idle)
        monkeypatch.setattr(Fitter, "settled", lambda self, fit: lucky if fit.causes else fit)
        here, (found,) = second_look(fitter, nothing, [idle])
        assert here.conditions.gap == is_gap(leftover(fitter.screen, here))
        assert found.misfit < fitter.remeasure(nothing).misfit
        assert here.misfit <= found.misfit + 1e-6
        assert not here.causes


@pytest.mark.slow
def test_a_window_slides_to_where_the_push_was(settled: Case) -> None:
    """Though slopes say nothing of a time that is a quarter of a second off."""
    push = {"fx": 0.0, "fy": 0.0, "fz": -30.0}
    case = logged(settled, [("external_force", ("trunk",), push | {"start": 0.6, "end": 1.3})])
    with fitting(case, ("external_force",)) as fitter:
        trunk = next(c for c in fitter.screen.candidates if c.place == ("trunk",) and c.names == tuple(push))
        every = {p.name: p for p in EFFECTS["external_force"].parameters(fitter.screen.simulator.context, ("trunk",))}
        brief = replace(trunk, parameters=tuple(every[n] for n in (*push, "start", "end")))
        late = fitter.looked_at(fitter.nominal(), [Cause(brief, (0.0, 0.0, -20.0, 0.85, 1.5))])
        assert late is not None
        found = fitter.settled(late).causes[0].named
    assert found["fz"] == pytest.approx(-30.0, rel=0.1)
    assert found["start"] == pytest.approx(0.6, abs=0.05)
    assert found["end"] == pytest.approx(1.3, abs=0.05)


def test_beside_causes_that_leave_no_gap_nothing_is_simulated_on_a_guess(settled: Case) -> None:
    higher = ("terrain_height", ("block_2",), {"height": 0.015})
    with fitting(logged(settled, [higher]), ("terrain_height", "ground_friction")) as fitter:
        for height, proposed in ((0.015, False), (-0.01, True)):
            there = fitter.reweighted(at(fitter, "terrain_height", "block_2", height))
            assert any(by_simulation(fitter.under_those_of(there), there)) == proposed


def test_a_height_is_found_short_of_one_at_which_the_foot_meets_other_ground(settled: Case) -> None:
    """Though no slope points there."""
    case = logged(settled, [("terrain_height", ("block_2",), {"height": -0.0155})])
    with fitting(case, ("terrain_height",)) as fitter:
        proposal = next(by_simulation(fitter, fitter.nominal()))
    (best,) = proposal.causes
    assert proposal.foretold > 100
    assert best.candidate.place == ("block_2",)
    assert best.named == {"height": pytest.approx(-0.015)}


def test_ground_that_slants_is_looked_at_about_each_axis(settled: Case, monkeypatch) -> None:
    """Slopes of feet that slip and land tell badly which way: their direction alone would miss it."""
    wrong = lambda screen, here: [(0.0, c, np.ones(len(c.linear))) for c in screen.candidates]  # noqa: E731
    monkeypatch.setattr("realsim.gap.inference.causes.proposals.ranked", wrong)
    case = logged(settled, [("terrain_tilt", (), {"roll": -0.03})])
    with fitting(case, ("terrain_tilt",)) as fitter:
        best = next(by_simulation(fitter, fitter.nominal())).causes[0]
    assert best.candidate.names == ("roll",)
    assert best.named["roll"] == pytest.approx(-0.03, abs=0.01)


def test_whether_there_is_a_gap_is_judged_beside_simulated_deviations(
    quadruped: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slopes alone leave one; what simulated deviations leave says how much a first cause must bring."""
    monkeypatch.setattr(Search, "_proposed", lambda *_: iter(()))
    case = logged(quadruped, [("coulomb_friction", ("fl_calf",), {"friction": 1.0})])
    with fitting(case, ("coulomb_friction",)) as fitter:
        for left, gap in ((1.3, False), (1.5, True)):
            stays = itertools.chain([np.full(1, 9.0)], itertools.repeat(np.full(1, left)))
            monkeypatch.setattr("realsim.gap.inference.causes.search.leftover", lambda *_, s=stays: next(s))
            search = Search(fitter, 3, fitter.nominal())
            search.run(lambda *_: None)
            assert search.fitter.conditions.gap is gap
            assert not search.best.causes
