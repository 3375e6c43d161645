"""The searches of the diagnosis: windows of time, slopes, and what unseen runs say of the outcome."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.gap import load_case
from realsim.gap.effects.base import Parameter
from realsim.gap.effects.lookup import lookup
from realsim.gap.figures import BRIEF, CAUSE, CAUSE_A_JOINT, CLEARLY, SHARE
from realsim.gap.inference.causes.fit import Cause, Fitter
from realsim.gap.inference.causes.fitted import at_an_end, at_bound, leftover
from realsim.gap.inference.causes.gauss_newton import Rough
from realsim.gap.inference.causes.proposals import by_slopes, ranked
from realsim.gap.inference.causes.score import doubts, least_gain, score, searched
from realsim.gap.inference.causes.search import Search
from realsim.gap.inference.causes.windows import _best_window
from realsim.gap.simulation.cores import Recent
from realsim.gap.simulation.simulate import Simulator

from .searching import CONFIG, fitting, logged
from .truth import Truth

WIDTH = 0.02


@given(st.integers(0, 200), st.integers(int(BRIEF / WIDTH), 180), st.floats(0.5, 5.0))
@settings(max_examples=30, deadline=None)
def test_a_window_of_force_is_found_to_the_bin(start: int, length: int, force: float) -> None:
    end = min(start + length, 300)
    if end - start < int(BRIEF / WIDTH):
        return
    push = np.array([force, -0.5 * force])
    inside = np.zeros(300)
    inside[start:end] = 1.0
    info = np.tile(50.0 * np.eye(2), (300, 1, 1))
    gradient = inside[:, None] * (50.0 * push)
    _, found_start, found_end, found = _best_window(info, gradient, np.ones(2), WIDTH)
    assert found_start == pytest.approx(start * WIDTH, abs=1e-9)
    assert found_end == pytest.approx(end * WIDTH, abs=1e-9)
    assert found == pytest.approx(push, rel=0.02)


@pytest.fixture(scope="module")
def fitter(made):
    """A log with a weaker motor at one joint, on a simulator whose slopes may take a step twice as long."""
    nominal = load_case(made(Truth(), runs=3))
    with Simulator(nominal, CONFIG) as simulator:
        joint = simulator.context.driven[0]
    case = logged(nominal, [("motor_gain", (joint,), {"ratio": -0.2})])
    with fitting(case, ("motor_gain", "backlash")) as found:
        found.screen.coarse = 2
        yield found


def _cause(fitter: Fitter, effect: str, value: float) -> Cause:
    return Cause(next(c for c in fitter.screen.candidates if c.effect == effect and len(c.places) == 1), (value,))


def test_what_only_reads_otherwise_shifts_the_readings(fitter: Fitter) -> None:
    simulator = fitter.screen.simulator
    joint = simulator.context.driven[0]
    damped = ("viscous_friction", (joint,), {"damping": 0.013})
    plain, shifted = (
        simulator.simulate(s)[0] for s in ([damped], [("joint_offset", (joint,), {"reading_offset": 0.02}), damped])
    )
    column = next(i for i, c in enumerate(simulator.channels) if c.signal == "joint_pos" and c.index == 0)
    np.testing.assert_allclose(shifted[:, column], plain[:, column] + 0.02, atol=1e-12)


def test_the_last_results_are_kept_and_no_more() -> None:
    recent, made = Recent[int](2), []
    for key in ("a", "b", "a", "c", "a", "b"):
        assert recent.get(key, lambda key=key: made.append(key) or ord(key)) == ord(key)
    assert made == ["a", "b", "c", "b"]
    assert recent.made == 4


def test_a_rough_look_sees_a_set_as_it_is_and_how_its_neighbours_differ(fitter: Fitter, monkeypatch) -> None:
    monkeypatch.setattr(fitter.screen, "varied", (0, 2))
    here = fitter.looked_at(fitter.nominal(), (_cause(fitter, "motor_gain", -0.1),))
    assert here is not None
    near, exact = fitter.rough(here), Rough((0, 2))
    assert near is not None
    assert near.added
    assert fitter.misfit(here.causes, near) == pytest.approx(fitter.misfit(here.causes, exact))
    assert fitter.misfit(here.causes, near) == pytest.approx(searched(fitter, here))
    there = (_cause(fitter, "motor_gain", -0.2),)
    gains = [fitter.misfit(here.causes, look) - fitter.misfit(there, look) for look in (near, exact)]
    assert gains[0] == pytest.approx(gains[1], rel=0.05)


def test_of_causes_that_do_the_same_the_one_at_fewer_places_comes_first(fitter: Fitter) -> None:
    """A torque limit that one joint reaches explains no more if another joint, which never does, has it too."""
    single = fitter.fit([_cause(fitter, "motor_gain", -0.2)])
    assert single is not None
    group = next(c for c in fitter.screen.candidates if c.effect == "motor_gain" and len(c.places) > 1)
    shared = replace(single, causes=(Cause(group, single.causes[0].values),), misfit=single.misfit - 0.1)
    assert score(fitter, single) < score(fitter, shared)
    assert score(fitter, replace(shared, misfit=single.misfit - 5.0)) < score(fitter, single)


def test_no_friction_at_all_is_an_answer_and_twice_the_range_is_none() -> None:
    friction = Parameter("friction", "N m", (-0.1, 100.0), 0.05, none_left=True)
    ratio = Parameter("ratio", "ratio", (-0.85, 2.0), 0.15)
    ends = [at_bound(friction, v) for v in (-0.1, -0.05, 0.0, 100.0)]
    assert ends == [False, False, False, True]
    assert [at_bound(ratio, v) for v in (-0.85, -0.8, 0.0, 2.0)] == [True, False, False, True]


def test_a_rotor_without_inertia_is_an_answer(fitter: Fitter) -> None:
    """The model of a real leg had a rotor that the leg has not: the search stopped at a tenth of it."""
    context, joint = fitter.screen.simulator.context, fitter.screen.simulator.context.driven[0]
    (inertia,) = lookup("armature").parameters(context, (joint,))
    assert inertia.bounds[0] == -context.armature(joint)
    assert not at_bound(inertia, inertia.bounds[0])


def test_a_strength_at_an_end_of_its_range_is_no_answer(fitter: Fitter) -> None:
    assert at_an_end(_cause(fitter, "motor_gain", 100.0)) == ["ratio"]
    assert at_an_end(_cause(fitter, "motor_gain", -0.9)) == []


def test_the_best_place_of_every_effect_is_fitted_before_a_second_one(fitter: Fitter) -> None:
    """Motors of all joints at 65 %: places of play in the gears had taken all the room that there is."""
    proposed = [p.causes[-1].candidate for p in by_slopes(fitter, fitter.nominal())]
    gains = {c.key: gain for gain, c, _ in ranked(fitter.screen, fitter.nominal())}
    effects = [c.effect for c in proposed]
    distinct = len(set(effects))
    assert distinct == 2
    assert set(effects[:distinct]) == set(effects)
    for effect in set(effects):
        own = [gains[c.key] for c in proposed if c.effect == effect]
        assert own == sorted(own, reverse=True)


@pytest.mark.parametrize(
    ("touches", "gap", "share"), [(False, False, 0.0), (True, False, SHARE), (False, True, 0.0), (True, True, 0.0)]
)
def test_a_cause_on_feet_takes_its_share_of_all(
    fitter: Fitter, touches: bool, gap: bool, share: float, monkeypatch
) -> None:
    """Where deviations leave no gap: feet that slip and land differ from a simulator's by many nats without a cause."""
    screen = fitter.screen
    known = fitter.under(gap=gap)
    monkeypatch.setattr(screen.simulator.context, "touches", touches)
    nothing = replace(fitter.nominal(), misfit=1000.0)
    assert least_gain(known, nothing) == max(0.0 if gap else CLEARLY, 1000.0 * share)
    found = fitter.fit([_cause(fitter, "motor_gain", -0.2)])
    assert found is not None
    assert leftover(screen, found).mean() < 1  # beside the right cause noise stays, and feet
    assert least_gain(known, replace(found, misfit=1000.0)) == max(CLEARLY, 1000.0 * SHARE * touches)


def test_a_first_cause_on_feet_holds_on_runs_left_out(fitter: Fitter, monkeypatch) -> None:
    """With a fixed base the check is on it alone: deviations imitate it on runs left out."""
    nothing = fitter.nominal()
    found = fitter.fit([_cause(fitter, "motor_gain", -0.2)])
    assert found is not None
    monkeypatch.setattr("realsim.gap.inference.causes.score.left_out", lambda *_: (-0.1, 0.2))
    for touches in (False, True):
        monkeypatch.setattr(fitter.screen.simulator.context, "touches", touches)
        said = doubts(fitter.under(gap=True), nothing, found)[0]
        assert said == ["does not hold on runs left out in turn"] * touches


def test_a_first_cause_is_cheap_where_deviations_leave_a_gap(fitter: Fitter) -> None:
    """What it costs does not depend on the robot's joints then, and what a further one costs does not on the gap."""
    screen = fitter.screen
    motor, play = (next(c for c in screen.candidates if c.effect == e) for e in ("motor_gain", "backlash"))
    one, two = (
        fitter.fit(causes, iterations=0)
        for causes in ((Cause(motor, (-0.2,)),), (Cause(motor, (-0.2,)), Cause(play, (0.01,))))
    )
    assert one is not None
    assert two is not None
    dear = CAUSE + CAUSE_A_JOINT * len(screen.simulator.case.joint_names)
    (sure_one, sure_two), (open_one, open_two) = (
        [score(fitter.under(gap=gap), f) for f in (one, two)] for gap in (True, False)
    )
    assert open_one - sure_one == pytest.approx(dear - np.log(len(screen.candidates)))
    assert open_two - open_one == pytest.approx(sure_two - sure_one)


def test_a_cause_is_proposed_in_its_simplest_form_and_with_all_that_the_log_can_show_of_it(made) -> None:
    """A mass at the tip of an arm: at the link's own centre it had fitted so badly that a weaker motor came first, and
    where it sits was not asked any more."""
    nominal = load_case(made(Truth(), runs=3))
    case = logged(nominal, [("payload", ("fore",), {"mass": 0.4, "x": 0.0, "y": 0.0, "z": -0.36})])
    with fitting(case, ("payload", "external_force", "motor_gain")) as fitter:
        forms = {c.names for c in fitter.screen.candidates if (c.effect, c.place) == ("external_force", ("fore",))}
        assert forms == {("fx",), ("fz",), ("fx", "fz")}  # the arm moves in the plane of x and z
        proposed = [p.causes[-1].candidate.key for p in by_slopes(fitter, fitter.nominal())]
        assert {("payload", ("fore",), ("mass",)), ("payload", ("fore",), ("mass", "x", "y", "z"))} <= set(proposed)
        search = Search(fitter, 1, fitter.nominal())
        search.run(lambda what, share: None)
        (cause,) = search.best.causes
    assert cause.candidate.key[:2] == ("payload", ("fore",))
    assert cause.named["mass"] == pytest.approx(0.4, rel=0.05)
    assert cause.named["z"] == pytest.approx(-0.36, abs=0.02)
