"""Rivals that the diagnosis knows of without looking: laws that contain each other, and effects that are one thing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.causes.equivalent import NO_PREFERENCE, _as_good, _as_likely, _plain, likelier
from realsim.gap.causes.fit import Cause, Fitter
from realsim.gap.causes.merit import price
from realsim.gap.causes.rivals import ranked
from realsim.gap.causes.screen import Screen
from realsim.gap.compare import Comparison
from realsim.gap.effects import EFFECTS
from realsim.gap.simulation.simulate import Simulator

from .test_recovery import logged
from .truth import Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)


@pytest.fixture(scope="module")
def arm(made) -> Case:
    return load_case(made("equivalent", Truth(), runs=3))


def test_beside_a_richer_friction_stands_the_plain_one(arm: Case) -> None:
    with Simulator(arm, CONFIG) as simulator:
        comparison = Comparison(arm, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(3), ("stribeck_friction", "coulomb_friction"))
    full = next(c for c in screen.candidates if c.effect == "stribeck_friction" and "coulomb" in c.names)
    values = {"static_friction": 0.1, "coulomb": 0.4, "stribeck_velocity": 0.1}
    (plain,) = _plain(screen, Cause(full, tuple(values[n] for n in full.names)))
    assert plain.candidate.effect == "coulomb_friction"
    assert plain.candidate.places == full.places
    assert plain.values == (0.4,)
    assert not _plain(screen, plain)


@pytest.mark.parametrize("name", ["command_delay", "observation_delay"])
def test_where_only_joints_are_logged_both_delays_are_named(name: str, arm: Case) -> None:
    case = logged(arm, [(name, (), {"delay": 0.02})])
    found = diagnose(case, replace(CONFIG, effects=("command_delay", "observation_delay"), bootstrap=20))
    assert found.verdict == "ambiguous"
    named = [found.causes[0]["effect"], *(c["effect"] for s in found.equivalent for c in s)]
    assert sorted(named) == ["command_delay", "observation_delay"]


@pytest.mark.parametrize(
    ("on_unseen_runs", "equivalent"), [((-5.0, 2.0, 0.0), True), ((-5.0, 2.0, 0.5), False), ((0.5, 2.0, 0.6), False)]
)
def test_a_richer_rival_counts_if_unseen_runs_gain_by_it(on_unseen_runs, equivalent, arm: Case, monkeypatch) -> None:
    """(Mean, standard error, share of runs) of what the simpler cause gains on runs left out: less than nothing."""
    with Simulator(arm, CONFIG) as simulator:
        comparison = Comparison(arm, simulator.channels, simulator.simulate(), CONFIG)
        fitter = Fitter(Screen(simulator, comparison, range(3), ("payload", "motor_gain")))
        by_length = {len(c.names): c for c in fitter.screen.candidates if c.effect == "payload"}
        weaker = next(c for c in fitter.screen.candidates if c.effect == "motor_gain" and len(c.places) == 1)
        simple = fitter.fit([Cause(weaker, (-0.1,))])
        rich = fitter.fit([Cause(by_length[4], (0.1, 0.0, 0.0, 0.1))])
    assert simple is not None
    assert rich is not None
    monkeypatch.setattr("realsim.gap.causes.equivalent.heldout", lambda *_: on_unseen_runs)
    rich = replace(rich, misfit=simple.misfit - 7.0, covariance=np.zeros((4, 4)))  # all four are known
    assert price(fitter.screen, rich) - price(fitter.screen, simple) > NO_PREFERENCE
    assert _as_good(fitter.screen, CONFIG, simple, rich, removed=500.0) == equivalent


def test_what_does_the_same_as_a_cause_is_no_further_one(arm: Case) -> None:
    with Simulator(arm, CONFIG) as simulator:
        comparison = Comparison(arm, simulator.channels, simulator.simulate(), CONFIG)
        fitter = Fitter(Screen(simulator, comparison, range(3), ("command_delay", "observation_delay")))
        delay = next(c for c in fitter.screen.candidates if c.effect == "command_delay")
        late = fitter.looked_at(fitter.nominal(), [Cause(delay, (0.02,))])
        assert late is not None
        assert len(ranked(fitter.screen, fitter.nominal())) == 2
        assert not ranked(fitter.screen, late)


@pytest.mark.parametrize("name", ["command_delay", "observation_delay"])
def test_an_imu_tells_them_apart_where_it_is_compared(name: str, arm: Case) -> None:
    effect = EFFECTS[name]
    with Simulator(arm, CONFIG) as simulator:
        assert effect.twinned(simulator.context)
        mute = also(arm, imu_acc=3, base_pos=3, contact=2)  # no site, a fixed base, and never compared
        assert effect.twinned(replace(simulator.context, case=mute))
        heard = replace(also(arm, imu_acc=3), imu_site="wrist")
        assert not effect.twinned(replace(simulator.context, case=heard))


def also(case: Case, **signals: int) -> Case:
    """The case with more signals, all zero, of so many columns."""
    return case.with_runs(
        tuple(replace(r, signals=r.signals | {k: np.zeros((len(r.time), n)) for k, n in signals.items()})
              for r in case.runs)
    )  # fmt: skip


def test_an_accelerometer_alone_has_a_bias(arm: Case) -> None:
    case = also(replace(arm, imu_site="wrist"), imu_acc=3)
    assert case.has_imu
    biased = logged(case, [("imu_bias", (), {"acc_y": 0.6})])
    found = diagnose(biased, replace(CONFIG, effects=("imu_bias", "coulomb_friction"), bootstrap=20))
    assert found.causes[0]["effect"] == "imu_bias"
    assert found.causes[0]["parameters"]["acc_y"]["value"] == pytest.approx(0.6, rel=0.1)


def test_the_more_usual_of_two_that_fit_alike_stands_first() -> None:
    def fit(effect: str, misfit: float, values: int = 1) -> Any:
        cause = SimpleNamespace(candidate=SimpleNamespace(effect=effect), values=(0.0,) * values)
        return SimpleNamespace(misfit=misfit, causes=(cause,))

    inertia, rotor, far = fit("link_inertia", 10.0), fit("armature", 11.0), fit("armature", 30.0)
    assert likelier(inertia, [rotor]) == (rotor, [inertia])
    assert likelier(inertia, [far]) == (inertia, [far])  # the runs prefer the first
    assert likelier(rotor, [inertia]) == (rotor, [inertia])
    tilt, offset = fit("terrain_tilt", 10.0, 2), fit("joint_offset", 10.1)
    assert likelier(tilt, [offset]) == (offset, [tilt])  # the same with one parameter less
    assert likelier(offset, [tilt]) == (offset, [tilt])
    assert likelier(tilt, [fit("joint_offset", 12.0)])[0] == tilt


def test_what_small_deviations_make_up_for_is_no_difference(arm: Case) -> None:
    """A lighter link and one whose mass sits elsewhere differ by what any robot's links may differ by."""
    case = logged(arm, [("com_offset", ("upper",), {"z": 0.03})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        names = ("com_offset", "payload", "link_inertia", "armature")
        fitter = Fitter(Screen(simulator, comparison, range(3), names))
        lighter = next(
            c for c in fitter.screen.candidates if (c.effect, c.place, c.names) == ("payload", ("upper",), ("mass",))
        )
        fit = fitter.fit([Cause(lighter, (-0.3,))])
        assert fit is not None
        rivals = _as_likely(fitter.screen, fitter, fit, fit.causes[0])
    assert ("com_offset", ("upper",)) in [(r.candidate.effect, r.candidate.place) for r in rivals]
