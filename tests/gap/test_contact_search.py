"""The search where feet slip and land: slopes say little, the misfit is jagged, small deviations imitate a cause."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig
from realsim.gap.causes.fit import Cause, Fit, Fitter
from realsim.gap.causes.probes import probed, probed_ground, standing_out
from realsim.gap.causes.refine import prepared, refined
from realsim.gap.causes.screen import Candidate, Screen
from realsim.gap.compare import Comparison
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged, quadruped  # noqa: F401

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)
pytestmark = pytest.mark.slow


@contextmanager
def fitter_for(case: Case, effects: tuple[str, ...]) -> Iterator[Fitter]:
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        yield Fitter(Screen(simulator, comparison, range(len(case.runs)), effects))


def candidate(fitter: Fitter, effect: str, *place: str) -> Candidate:
    return next(c for c in fitter.screen.candidates if c.effect == effect and c.place == place)


def at(fitter: Fitter, effect: str, place: str, value: float) -> Fit:
    fit = fitter.looked_at(fitter.nominal(), [Cause(candidate(fitter, effect, place), (value,))])
    assert fit is not None
    return fit


def test_a_tilt_stands_out_in_its_sense(quadruped: Case) -> None:  # noqa: F811
    case = logged(logged(quadruped, []), [("terrain_tilt", (), {"roll": 0.03, "pitch": -0.02})])
    with fitter_for(case, ("terrain_tilt", "joint_offset")) as fitter:
        nominal = fitter.nominal()
        found = {c.effect: (c, estimate) for c, estimate in reversed(standing_out(fitter.screen, nominal))}
        tilt, estimate = found["terrain_tilt"]
        truth = {"roll": 0.03, "pitch": -0.02}
        assert all(np.sign(e) == np.sign(truth[n]) for n, e in zip(tilt.names, estimate, strict=True))
        assert "terrain_tilt" in [c.effect for _, c, _ in probed(fitter.screen, fitter, nominal, [])]


def test_nothing_stands_out_where_nothing_is(quadruped: Case) -> None:  # noqa: F811
    with fitter_for(logged(quadruped, []), ("terrain_tilt", "joint_offset", "damping_gain")) as fitter:
        assert standing_out(fitter.screen, fitter.nominal()) == []


def test_a_second_fit_begins_beside_the_values_at_which_a_first_one_got_stuck(quadruped: Case) -> None:  # noqa: F811
    case = logged(logged(quadruped, []), [("coulomb_friction", ("fl_calf",), {"friction": 1.0})])
    with fitter_for(case, ("coulomb_friction", "load_friction")) as fitter:
        nominal = fitter.nominal()
        stuck = [at(fitter, "load_friction", "fl_calf", 0.14), at(fitter, "coulomb_friction", "fl_calf", 1.25)]
        _, fits = refined(fitter, nominal, sorted(stuck, key=lambda f: f.misfit))
        cause = fits[0].causes[0]
        assert cause.candidate.effect == "coulomb_friction"
        assert abs(cause.values[0] - 1.0) < 0.2


def test_causes_and_deviations_are_settled_together_and_nothing_else_moves(quadruped: Case) -> None:  # noqa: F811
    deviations = [("motor_gain", (j,), {"ratio": 0.04}) for j in ("fl_thigh", "hr_calf")]
    cause = ("coulomb_friction", ("fl_calf",), {"friction": 1.0})
    case = logged(logged(quadruped, []), [cause, *deviations])
    with fitter_for(case, ("coulomb_friction", "motor_gain")) as fitter:
        before, about = at(fitter, "coulomb_friction", "fl_calf", 0.8), fitter.about.copy()
        after = fitter.with_own_nuisances(before)
        assert np.array_equal(fitter.about, about)
        assert after.misfit < before.misfit
        assert 0.8 < after.causes[0].values[0] < 1.1


def test_slopes_are_not_taken_anew_where_a_law_makes_every_step_much_finer(
    quadruped: Case,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with fitter_for(logged(quadruped, []), ("coulomb_friction", "stribeck_friction")) as fitter:
        taken = []
        monkeypatch.setattr(fitter.screen, "relinearise", lambda settings: taken.append(settings[0][0]))
        dip = next(c for c in fitter.screen.candidates if c.effect == "stribeck_friction" and len(c.names) == 3)
        values = {"static_friction": 2.0, "coulomb": 0.5, "stribeck_velocity": 0.02}
        narrow = fitter.looked_at(fitter.nominal(), [Cause(dip, tuple(values[n] for n in dip.names))])
        assert narrow is not None
        for fit in (narrow, at(fitter, "coulomb_friction", "fl_calf", 1.0)):
            prepared(fitter, fit)
    assert taken == ["coulomb_friction"]


def test_a_height_is_found_short_of_one_at_which_the_foot_meets_other_ground(quadruped: Case) -> None:  # noqa: F811
    case = logged(logged(quadruped, []), [("terrain_height", ("block_2",), {"height": -0.0155})])
    with fitter_for(case, ("terrain_height",)) as fitter:
        _, best, start = probed_ground(fitter.screen, fitter, fitter.nominal(), fitter.screen.candidates)[0]
    assert best.place == ("block_2",)
    assert start == {"height": pytest.approx(-0.015)}


def test_a_richer_law_must_be_clearly_better_where_feet_slip(quadruped: Case) -> None:  # noqa: F811
    case = logged(logged(quadruped, []), [("coulomb_friction", ("fl_calf",), {"friction": 1.0})])
    with fitter_for(case, ("coulomb_friction", "stribeck_friction")) as fitter:
        nominal, plain = fitter.nominal(), at(fitter, "coulomb_friction", "fl_calf", 0.93)
        dip = next(
            c for c in fitter.screen.candidates
            if (c.effect, c.place, len(c.names)) == ("stribeck_friction", ("fl_calf",), 3)
        )  # fmt: skip
        values = {"static_friction": 1.1, "coulomb": 1.0, "stribeck_velocity": 0.3}
        rich = fitter.looked_at(nominal, [Cause(dip, tuple(values[n] for n in dip.names))])
        assert rich is not None
        _, fits = refined(fitter, nominal, sorted([plain, rich], key=lambda f: f.misfit))
    assert fits[0].causes[0].candidate.effect == "coulomb_friction"
