"""The linear picture of a log: centres of small deviations, slopes beside a cause, a law inside a richer one."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.gap import EFFECTS, Case, figures, load_case
from realsim.gap.case.model.edit import Edit
from realsim.gap.inference.causes.fit import Cause, Fitter
from realsim.gap.inference.causes.fitted import leftover
from realsim.gap.inference.causes.proposals import by_effect
from realsim.gap.inference.causes.search import Search
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.linear import Evidence
from realsim.gap.inference.likelihood.screen import Screen
from realsim.gap.simulation.sampling import AT, either_side
from realsim.gap.simulation.simulate import Simulator
from tests.truths.diagnosis.cases import Sensors, write_log
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth as TrueRobot

from .searching import CONFIG, logged
from .truth import ARM, FINE, Truth


@pytest.fixture(scope="module")
def arm(made) -> Case:
    return load_case(made(Truth(), FINE, runs=2))


def screened(case: Case, effects: tuple[str, ...]) -> Screen:
    simulator = Simulator(case, CONFIG)
    comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
    return Screen(simulator, comparison, range(len(case.runs)), effects)


@given(st.integers(0, 10_000))
def test_evidence_about_another_centre_is_that_of_the_shifted_residual(seed: int) -> None:
    rng = np.random.default_rng(seed)
    G, r, shift = rng.normal(size=(30, 4)), rng.normal(size=30), rng.normal(size=4)
    evidence = Evidence([G.T @ G], [G.T @ r], [float(r @ r)])
    moved, rest = evidence.moved(shift), r - G @ shift
    assert moved.b[0] == pytest.approx(G.T @ rest)
    assert moved.c[0] == pytest.approx(float(rest @ rest))
    assert moved.centre == pytest.approx(shift)
    back = moved.moved(-shift)
    assert back.b[0] == pytest.approx(evidence.b[0])
    assert back.c[0] == pytest.approx(evidence.c[0])


@pytest.mark.parametrize(("finer", "centre"), [(0.0, 0.0), (0.75, 1.0)])
def test_small_robots_live_in_the_simulators_step_or_in_continuous_time(arm: Case, finer: float, centre: float) -> None:
    screen = screened(logged(arm, [("time_step", (), {"finer": finer})]), ("armature",))
    nominal = Fitter.of(screen).nominal()
    step = screen.index["time_step", (), "finer"]
    assert np.broadcast_to(nominal.evidence.centre, len(screen.atoms))[step] == centre
    assert leftover(screen, nominal).mean() < 1.0


def test_an_imu_that_is_late_is_read_late(tmp_path) -> None:
    robot = ROBOTS["quadruped"](np.random.default_rng(2))
    times = np.arange(0.0, 1.5, 0.01)
    command = robot.home + 0.1 * np.sin(6 * times)[:, None]
    plant = Plant(robot, TrueRobot(len(robot.joints)))
    trace = plant.drive(times, command)
    rng = np.random.default_rng(1)
    sensors = Sensors(100.0, True, "none", 1.0, True, 2e-4, 16)
    write_log(tmp_path / "case", robot, sensors, TrueRobot(len(robot.joints)), [(times, command)], [trace], rng)
    late = 0.003
    with Simulator(load_case(tmp_path / "case"), CONFIG) as simulator:
        run = simulator.case.runs[0]
        earlier = dataclasses.replace(run, time=run.time - late)
        edit = Edit(simulator.context)
        raw = simulator.nominal_tracks[0]
        now, then = simulator.read(run, raw, edit), simulator.read(earlier, raw, edit)
        edit.signals.imu_delay = late
        read = simulator.read(run, raw, edit)
        gyro, acc = (np.array([c.signal == n for c in simulator.channels]) for n in ("imu_gyro", "imu_acc"))
    others = ~(gyro | acc)
    assert (read[:, others] == now[:, others]).all()
    assert read[:, gyro] == pytest.approx(then[:, gyro])
    assert np.abs(read - now)[:, gyro].max() > 0.01
    assert np.abs(read - now)[:, acc].max() > 0.01


@given(st.floats(4.01, 5.99), st.floats(-2.5, 2.5), st.integers(0, 10_000))
def test_a_sample_is_on_its_own_side_of_a_jump(position: float, behind: float, seed: int) -> None:
    """Two straight lines that meet in a jump: a sample before it sees the first only, one after it the second."""
    a, b, c, d = np.random.default_rng(seed).normal(size=4)
    row, jump = np.arange(12.0), position - behind
    values = np.where(row < jump, a + b * row, c + d * row)
    values[int(jump)] = 100.0  # the row in whose step it falls is a mean of both
    before, after = either_side(values[:, None], np.array([position]), np.array([jump]))
    first, second = a + b * position, c + d * position
    if abs(behind) < AT / 2:
        assert (before[0, 0], after[0, 0]) == pytest.approx((first, second), abs=1e-9)
    elif abs(behind) > 2 * AT:
        assert before[0, 0] == after[0, 0] == pytest.approx(second if behind > 0 else first, abs=1e-9)


@given(st.floats(4.01, 5.99), st.integers(0, 10_000))
def test_a_sample_at_a_jump_has_both_sides(position: float, seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=2)
    values = np.where(np.arange(12.0) < position, a, b)
    before, after = either_side(values[:, None], np.array([position]), np.array([position]))
    assert (before[0, 0], after[0, 0]) == pytest.approx((a, b))


def test_an_accelerometer_is_read_before_the_command_acts_or_after(arm: Case) -> None:
    """Steps of the command between two rows of the simulator: the samples at these moments are on one side of it."""
    time = np.arange(0.0, 1.5, 0.0105)  # never twice in the same place between two rows
    command = 0.3 * np.sign(np.sin(9 * time))[:, None] * np.array([1.0, -1.0])
    signals = {"joint_pos": command, "imu_acc": np.zeros((len(time), 3))}
    run = dataclasses.replace(arm.runs[0], time=time, command=command, signals=signals)
    with Simulator(dataclasses.replace(arm, imu_site="wrist", runs=(run,)), CONFIG) as simulator:
        acc = [k for k, channel in enumerate(simulator.channels) if channel.signal == "imu_acc"]
        before, after = (simulator.simulate([("imu_phase", (), {"phase": p})])[0][:, acc] for p in (0.0, 1.0))
    steps = np.abs(np.diff(command[:, 0], prepend=command[0, 0])) > 0.1
    steps &= time > 0.5  # a start in the state of this log, which jumps, still rings before
    jump = np.linalg.norm(after - before, axis=1)
    assert jump[steps].min() > 20 * np.median(jump[~steps])
    gravity = 9.81
    assert np.linalg.norm(before, axis=1)[steps].max() < gravity + 0.3 * jump[steps].min()


def test_slopes_are_taken_anew_beside_a_cause(arm: Case) -> None:
    screen = screened(arm, ("armature", "motor_gain"))
    cause = ("motor_gain", ("shoulder",), {"ratio": -0.5})
    i = screen.index["armature", ("elbow",), "armature"]
    own = screen.index["motor_gain", ("shoulder",), "ratio"]
    before = [screen.columns(k, [i, own]).copy() for k in range(len(screen.runs))]
    fitter = Fitter.of(screen)
    old = fitter.nominal().evidence
    screen.relinearise([cause], fitter.conditions)
    assert fitter.nominal().evidence.version > old.version  # what was weighed with the old slopes is weighed again
    width = 0.05 * screen.atoms[i].parameter.step
    base, moved = (
        screen.simulator.simulate([cause, *extra], runs=screen.runs)
        for extra in ([], [("armature", ("elbow",), {"armature": width})])
    )
    for k, run in enumerate(screen.runs):
        direct = screen.comparison.change(run, moved[k], base[k]).reshape(-1) / width
        now = screen.columns(k, [i, own])
        assert np.linalg.norm(now[:, 0] - direct) < 0.1 * np.linalg.norm(direct)
        assert np.linalg.norm(before[k][:, 0] - direct) > 2 * np.linalg.norm(now[:, 0] - direct)
        assert (now[:, 1] == before[k][:, 1]).all()


def test_what_does_nothing_beside_a_cause_explains_nothing_there(arm: Case) -> None:
    screen = screened(arm, ("stiffness_gain",))
    dead, other = (screen.index["stiffness_gain", (joint,), "ratio"] for joint in ("elbow", "shoulder"))
    assert all(np.abs(screen.columns(k, [dead])).max() > 0 for k in range(len(screen.runs)))
    screen.relinearise([("motor_gain", ("elbow",), {"ratio": -40.0})], Fitter.of(screen).conditions)
    for k in range(len(screen.runs)):
        assert (screen.columns(k, [dead]) == 0).all()
        assert np.abs(screen.columns(k, [other])).max() > 0


def two_arms(coupling: str = "") -> str:
    """Two arms on one stand."""
    body, servos = (ARM.split(f"<{tag}>")[1].split(f"</{tag}>")[0] for tag in ("worldbody", "actuator"))
    other = body + "|" + servos
    for name in ("upper", "fore", "shoulder", "elbow", "wrist"):
        other = other.replace(f'"{name}', f'"left_{name}')
    left, left_servos = other.replace('pos="0 0 1"', 'pos="0 1 1"').split("|")
    made = ARM.replace(body, body + left).replace(servos, servos + left_servos)
    return made.replace("</mujoco>", coupling + "</mujoco>")


def test_arms_that_do_not_feel_one_another_have_the_slopes_of_each_alone(made, monkeypatch) -> None:
    effects = ("payload", "viscous_friction", "backlash")
    case = load_case(made(Truth(), two_arms(), runs=2, span=(1.6, 1.8)))
    screen = screened(case, effects)
    assert len(set(screen.trees.values())) == 2
    screen.relinearise([("viscous_friction", ("elbow",), {"damping": 0.4})], Fitter.of(screen).conditions)
    together = [screen.columns(k, range(len(screen.atoms))) for k in range(2)]
    monkeypatch.setattr(Screen, "_apart", lambda *_: {})
    alone = screened(case, effects)
    alone.relinearise([("viscous_friction", ("elbow",), {"damping": 0.4})], Fitter.of(alone).conditions)
    assert [(a.effect, a.place) for a in alone.atoms] == [(a.effect, a.place) for a in screen.atoms]
    for k, columns in enumerate(together):
        other = alone.columns(k, range(len(alone.atoms)))
        np.testing.assert_allclose(columns, other, rtol=1e-4, atol=1e-6 * np.abs(other).max())


def test_arms_that_hold_each_other_are_one_robot(made) -> None:
    bar = '<equality><joint joint1="elbow" joint2="left_elbow" solref="0.02 1"/></equality>'
    case = load_case(made(Truth(), two_arms(bar), runs=2, span=(1.6, 1.8)))
    assert screened(case, ("payload", "viscous_friction")).trees == {}


def test_a_search_that_fails_on_a_run_it_did_not_look_at_finds_nothing(made, monkeypatch) -> None:
    case = load_case(made(Truth(), FINE, runs=4))
    assert screened(case, ("armature",)).varied is None  # an arm is simulated fast: all runs are looked at
    monkeypatch.setattr(figures, "WORK", 1000.0)
    screen = screened(case, ("armature",))
    assert screen.varied is not None
    assert len(screen.varied) < len(screen.runs)
    fitter = Fitter.of(screen)
    cause = Cause(screen.candidates[0], (0.01,))
    assert fitter.fit([cause], few=fitter.rough(fitter.nominal())) is not None
    few, simulate = fitter.rough(fitter.nominal()), screen.simulator.simulate

    def falls(settings=(), runs=None, coarse=1, **given):
        made = simulate(settings, runs, coarse, **given)
        return [np.full_like(y, np.nan) for y in made] if settings and len(made) == len(screen.runs) else made

    monkeypatch.setattr(screen.simulator, "simulate", falls)
    assert Fitter.of(screen).fit([cause], few=few) is None


def test_a_richer_law_takes_the_place_of_the_plain_one(arm: Case) -> None:
    truth = {"static_friction": 3.0, "coulomb": 1.0, "stribeck_velocity": 0.1}
    case = logged(arm, [("stribeck_friction", ("shoulder",), truth)])
    screen = screened(case, ("coulomb_friction", "stribeck_friction"))
    fitter = Fitter.of(screen)
    of = {(c.effect, c.place, len(c.names)): c for c in screen.candidates}
    plain = fitter.fit([Cause(of["coulomb_friction", ("shoulder",), 1], (1.0,))])
    assert plain is not None
    (proposal,) = by_effect(fitter, plain)
    found = fitter.fit(proposal.causes, proposal.starts)
    assert found is not None
    assert [c.candidate.effect for c in found.causes] == ["stribeck_friction"]
    assert found.misfit < plain.misfit - 5
    assert found.causes[0].named["static_friction"] > 1.5 * found.causes[0].named["coulomb"]


def test_a_superfluous_cause_is_dropped(arm: Case) -> None:
    case = logged(arm, [("motor_gain", ("elbow",), {"ratio": -0.3})])
    screen = screened(case, ("motor_gain", "viscous_friction"))
    of = {(c.effect, c.place): c for c in screen.candidates}
    real = Cause(of["motor_gain", ("elbow",)], (-0.3,))
    idle = Cause(of["viscous_friction", ("shoulder",)], (0.01,))
    fitter = Fitter.of(screen)
    both = fitter.fit([idle, real])
    assert both is not None
    search = Search(fitter, 2, both)
    search.seen[frozenset()] = fitter.nominal()
    search.run(lambda what, share: None)
    assert [c.candidate.effect for c in search.best.causes] == ["motor_gain"]
    assert any("viscous_friction shoulder was taken out again" in note for note in search.notes)


@pytest.mark.parametrize(("name", "values"), [("damping_gain", {"ratio": 0.3}), ("viscous_friction", {"damping": 1.5})])
def test_braking_by_the_servo_and_by_grease_is_one_motion(arm: Case, name: str, values: dict[str, float]) -> None:
    with Simulator(arm, CONFIG) as simulator:
        place = ("shoulder",)
        (found,) = EFFECTS[name].rivals.suggest(simulator.context, place, values)
        other, same = found.effect, found.values
        (back,) = EFFECTS[other].rivals.suggest(simulator.context, place, same)
        assert (back.effect, back.values) == (name, pytest.approx(values))
        (wide,) = EFFECTS[other].parameters(simulator.context, place)
        assert 15 * next(iter(same.values())) < wide.bounds[1]  # and as far as anyone would go
        moves = [c for c, channel in enumerate(simulator.channels) if channel.signal in ("joint_pos", "joint_vel")]
        one, two, nominal = (simulator.simulate(s) for s in ([(name, place, values)], [(other, place, same)], []))
    for a, b, n in zip(one, two, nominal, strict=True):
        assert np.abs(a - n)[:, moves].max() > 1e-3
        assert np.abs(a - b)[:, moves].max() < 0.05 * np.abs(a - n)[:, moves].max()


class Jagged(Fitter):
    """In the first run a foot slips or trips now and then: steep slopes that foretell nothing."""

    def predict(self, causes, few=None):
        found = super().predict(causes, few)
        if found is None or not causes or (few is not None and 0 not in few.runs):
            return found
        ripple = 0.02 * np.sin(60.0 * causes[0].values[0] / abs(causes[0].candidate.parameters[0].step))
        return [y + ripple * (i == 0) for i, y in enumerate(found)]


def test_a_run_of_which_slopes_foretell_nothing_does_not_stop_the_others(arm: Case) -> None:
    joint = arm.joint_names[0]
    case = logged(arm, [("viscous_friction", (joint,), {"damping": 0.3})])
    fitter = Jagged.of(screened(case, ("viscous_friction",)))
    found = next(c for c in fitter.screen.candidates if c.effect == "viscous_friction" and c.place == (joint,))
    fit = fitter.fit([Cause(found, (0.03,))], iterations=8)
    assert fit is not None
    assert fit.causes[0].values[0] == pytest.approx(0.3, rel=0.1)
