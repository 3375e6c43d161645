"""Rivals that the diagnosis knows of without looking: laws that contain each other, and effects that are one thing."""

from dataclasses import replace

import numpy as np
import pytest

from realsim.gap import Case, diagnose, load_case
from realsim.gap.effects import EFFECTS
from realsim.gap.inference.causes.fit import Cause
from realsim.gap.inference.causes.fitted import values_of
from realsim.gap.inference.causes.proposals import by_effect
from realsim.gap.inference.causes.score import alike, bent, score
from realsim.gap.inference.causes.select import _in_order, _richer
from realsim.gap.simulation.simulate import Simulator

from .searching import CONFIG, fitting, logged
from .truth import Truth


@pytest.fixture(scope="module")
def arm(made) -> Case:
    return load_case(made(Truth(), runs=3))


def test_a_law_that_contains_another_is_compared_with_it_both_ways(arm: Case) -> None:
    with fitting(arm, ("stribeck_friction", "coulomb_friction")) as fitter:
        full = next(c for c in fitter.screen.candidates if c.effect == "stribeck_friction" and "coulomb" in c.names)
        values = {"static_friction": 0.1, "coulomb": 0.4, "stribeck_velocity": 0.1}
        rich = Cause(full, tuple(values[n] for n in full.names))
        others = [p.causes[0] for p in by_effect(fitter, replace(fitter.nominal(), causes=(rich,)))]
        (plain,) = (c for c in others if c.candidate.effect == "coulomb_friction")
        assert plain.candidate.places == full.places
        assert plain.values == (0.4,)
        (back,) = by_effect(fitter, replace(fitter.nominal(), causes=(plain,)))
        assert back.causes[0].candidate.key == full.key
        assert back.causes[0].named["coulomb"] == 0.4


def test_a_law_that_holds_another_one_is_said_after_it_and_only_where_its_score_is_lower(arm: Case) -> None:
    with fitting(arm, ("stribeck_friction", "coulomb_friction", "armature")) as fitter:
        nominal, by_effect = fitter.nominal(), {}
        for c in fitter.screen.candidates:
            by_effect.setdefault(c.effect, Cause(c, (0.0,) * len(c.names)))
        plain, rich, other = (
            replace(nominal, causes=tuple(by_effect[n] for n in names))
            for names in (
                ("coulomb_friction", "armature"),
                ("stribeck_friction", "armature"),
                ("stribeck_friction",),
            )
        )
        assert _richer(rich, plain)
        assert not _richer(plain, rich)
        assert not _richer(other, replace(nominal, causes=(by_effect["armature"],)))
        assert not _richer(plain, plain)

        plain, rich = (replace(f, covariance=np.zeros((len(values_of(f.causes)),) * 2)) for f in (plain, rich))
        level = replace(rich, misfit=rich.misfit + score(fitter, plain) - score(fitter, rich))
        worse, better = (replace(level, misfit=level.misfit + nats) for nats in (1.0, -1.0))
        assert [f is plain for f in _in_order(fitter, [worse, plain])] == [True]
        assert [f is plain for f in _in_order(fitter, [plain, better])] == [True, False]


def test_what_an_effect_is_taken_for_is_among_what_it_suggests(arm: Case) -> None:
    with Simulator(arm, CONFIG) as simulator:
        context = simulator.context
    for effect in (e for e in EFFECTS.values() if e.rivals.compared):
        for place in effect.places(context):
            values = {p.name: p.default + 0.3 * p.step for p in effect.parameters(context, place)}
            assert set(effect.rivals.compared) <= {s.effect for s in effect.rivals.suggest(context, place, values)}


def test_where_only_joints_are_logged_both_delays_are_named(arm: Case) -> None:
    case = logged(arm, [("observation_delay", (), {"delay": 0.02})])
    found = diagnose(case, replace(CONFIG, effects=("command_delay", "observation_delay"), bootstrap=20))
    assert found.verdict == "ambiguous"
    named = [found.causes[0]["effect"], *(c["effect"] for s in found.equivalent for c in s)]
    assert sorted(named) == ["command_delay", "observation_delay"]


@pytest.mark.parametrize("name", ["command_delay", "observation_delay"])
def test_an_imu_tells_them_apart_where_it_is_compared(name: str, arm: Case) -> None:
    effect = EFFECTS[name]
    with Simulator(arm, CONFIG) as simulator:
        found = {s.effect for s in effect.rivals.suggest(simulator.context, (), {"delay": 0.02})}
        assert {name, *found} == {"command_delay", "observation_delay", "actuator_lag"}
        mute = also(arm, imu_acc=3, base_pos=3, contact=2)  # no site, a fixed base, and never compared
        assert len(effect.rivals.suggest(replace(simulator.context, case=mute), (), {"delay": 0.02})) == 2
        heard = replace(also(arm, imu_acc=3), imu_site="wrist")
        (lag,) = effect.rivals.suggest(replace(simulator.context, case=heard), (), {"delay": 0.02})
        assert lag.effect == "actuator_lag"


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


def test_a_rotor_and_the_link_that_it_turns_first_are_alike(arm: Case) -> None:
    """The rival's values are brought up to date before it is compared: they were found under other weights."""
    heavy = logged(arm, [("link_inertia", ("upper",), {"ratio": 2.0})])
    found = diagnose(heavy, replace(CONFIG, effects=("link_inertia", "armature"), bootstrap=20))
    said = [found.causes, *found.equivalent]
    assert {c["effect"] for causes in said for c in causes} == {"link_inertia", "armature"}


@pytest.mark.parametrize("moving", [False, True])
def test_twins_are_alike_whatever_the_steps_of_the_simulator_make_of_them(arm: Case, moving: bool) -> None:
    """Of a robot that begins at rest, joints alone do not tell late commands from late readings."""
    with fitting(arm, ("command_delay", "observation_delay")) as fitter:
        fits = []
        for effect in ("command_delay", "observation_delay"):
            candidate = next(c for c in fitter.screen.candidates if c.effect == effect)
            fits.append(fitter.looked_at(fitter.nominal(), [Cause(candidate, (0.02,))]))
        best, rival = fits
        assert best is not None
        assert rival is not None
        simulator = fitter.screen.simulator
        if moving:
            simulator.starts = tuple(replace(s, qpos=np.zeros(arm.model.nq)) for s in simulator.starts)
        rival = replace(rival, misfit=best.misfit + 1e4)
        assert alike(fitter, best, rival, removed=1e3) is not moving


def test_a_size_that_no_such_robot_has_comes_after_one_that_it_may_have(arm: Case) -> None:
    """However well it fits: it can be bent to whatever is wrong."""
    with fitting(arm, ("coulomb_friction", "armature")) as fitter:
        rotor, friction = (
            next(c for c in fitter.screen.candidates if c.effect == n) for n in ("armature", "coulomb_friction")
        )
        nominal, most = fitter.nominal(), rotor.parameters[0].plausible[0]
        huge, usual = (
            replace(nominal, causes=(Cause(rotor, (size * most,)),), covariance=np.eye(1), misfit=nominal.misfit - 30)
            for size in (1.5, 0.2)
        )
        plain = replace(nominal, causes=(Cause(friction, (0.2,)),), covariance=np.eye(1), misfit=nominal.misfit - 20)
        assert [f is plain for f in _in_order(fitter, [huge, plain])] == [True, False]
        assert [f is plain for f in _in_order(fitter, [usual, plain])] == [False, True]
        assert bent(nominal, huge) > 0 == bent(nominal, usual)
