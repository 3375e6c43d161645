"""Every effect that a log can show is found again where the library's own simulator put it, and absent where not."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
import pytest

from realsim.gap import EFFECTS, Case, DiagnoseConfig, effects, load_case
from realsim.gap.effects.base import Effect
from realsim.gap.inference.causes.fit import Cause, Fitter
from realsim.gap.inference.causes.leftover import deviations, is_gap, leftover
from realsim.gap.inference.causes.proposals import by_simulation
from realsim.gap.inference.causes.starts import starts
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.linear import log_evidence, marginal
from realsim.gap.inference.likelihood.screen import Screen, slab
from realsim.gap.simulation.simulate import Simulator
from tests.truths.diagnosis.plant import Plant
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth as TrueRobot

from .truth import Truth

CONFIG = DiagnoseConfig(threads=1, settle_seconds=0.3)
GROUND = ("ground_friction", "contact_compliance", "terrain_height", "terrain_tilt", "terrain_scale", "terrain_wobble")
SIZE = {"ground_friction": 1.0, "imu_bias": 8.0, "load_friction": 2.0, "stribeck_friction": 2.0, "terrain_scale": 2.0}
"""In steps of the parameter; 1.5 where nothing stands."""
UNSEEN = ("camera_delay", "camera_mount", "depth_noise")


@pytest.fixture(scope="module")
def arm(made) -> Case:
    case = load_case(made("recovery", Truth(), runs=2, span=(2.2, 2.6)))
    return case


@pytest.fixture(scope="module")
def quadruped(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A floating base on four blocks: the log is made by its own simulator."""
    folder = tmp_path_factory.mktemp("quadruped")
    robot = ROBOTS["quadruped"](np.random.default_rng(2))
    (folder / "runs").mkdir()
    (folder / "model.xml").write_text(robot.xml)
    log = {
        "joint_names": robot.joints,
        "actuator_names": robot.actuators,
        "command_kind": "position",
        "command_hold": "zoh",
        "base": "floating",
        "torque_kind": "none",
        "imu_site": robot.imu_site,
        "contact_bodies": [],
        "notes": "",
    }
    (folder / "log.json").write_text(json.dumps(log))
    time = np.arange(0, 2.0, 0.01)
    sway = 0.15 * np.sin(2 * np.pi * np.outer(time, [0.9])) * np.tile([1.0, 0.8, 0.3], 4)
    command = robot.home + np.clip(time / 0.3, 0, 1)[:, None] * sway
    trace = Plant(robot, TrueRobot(len(robot.joints))).drive(time, command)  # it knows how the robot comes to rest
    rest = {"init_qpos": trace.qpos0, "init_qvel": np.zeros(len(trace.qpos0) - 1)}
    rest |= {"base_pos": np.tile(trace.qpos0[:3], (len(time), 1))}
    imu = {"imu_gyro": np.zeros((len(time), 3)), "imu_acc": np.zeros((len(time), 3))}
    np.savez(folder / "runs" / "one.npz", time=time, command=command, joint_pos=command, **rest, **imu)
    return load_case(folder)


def logged(case: Case, settings: list, seed: int = 0) -> Case:
    """The case with the log that its simulator writes under these settings, with a little noise."""
    rng = np.random.default_rng(seed)
    with Simulator(case, CONFIG) as simulator:
        made = simulator.simulate(settings)
        channels = simulator.channels
    runs = []
    for run, y in zip(case.runs, made, strict=True):
        signals = {}
        for name in dict.fromkeys(c.signal for c in channels):
            values = y[:, [i for i, c in enumerate(channels) if c.signal == name]]
            if name != "base_rot":
                signals[name] = values + rng.normal(0, 1e-4, values.shape)
        runs.append(replace(run, signals=run.signals | signals))
    return case.with_runs(tuple(runs))


@pytest.mark.parametrize("name", [n for n in EFFECTS if n not in (*UNSEEN, *GROUND, "imu_bias", "thrust_gain")])
def test_recovered_on_an_arm(name: str, arm: Case) -> None:
    recover(name, arm)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*GROUND, "imu_bias"])
def test_recovered_on_a_floating_base(name: str, quadruped: Case) -> None:
    recover(name, logged(quadruped, []))


@pytest.mark.slow
def test_the_block_that_is_lower_is_found_though_no_slope_points_there(quadruped: Case) -> None:
    case = logged(logged(quadruped, []), [("terrain_height", ("block_2",), {"height": -0.02})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), ("terrain_height",))
        fitter = Fitter(screen)
        proposal = next(by_simulation(fitter, fitter.nominal()))
    assert proposal.foretold > 100
    assert proposal.causes[0].candidate.place == ("block_2",)
    assert proposal.causes[0].named == {"height": pytest.approx(-0.02)}


@pytest.mark.slow
def test_an_encoder_that_sets_a_foot_higher_is_found_though_no_slope_points_there(quadruped: Case) -> None:
    """Other feet carry the robot then; the ground under one of them may do much the same."""
    case = logged(logged(quadruped, []), [("joint_offset", ("fl_calf",), {"offset": -0.06})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), ("joint_offset", "terrain_height"))
        fitter = Fitter(screen)
        proposals = list(by_simulation(fitter, fitter.nominal()))
    best = max((p for p in proposals if p.causes[0].candidate.effect == "joint_offset"), key=lambda p: p.foretold)
    assert best.foretold > 100
    assert best.causes[0].candidate.place == ("fl_calf",)
    assert best.causes[0].named == {"offset": pytest.approx(-0.06, rel=0.5)}


def test_a_robot_that_does_not_stand_has_no_footing(arm: Case) -> None:
    with Simulator(arm, CONFIG) as simulator:
        comparison = Comparison(arm, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(arm.runs)), ("joint_offset",))
        fitter = Fitter(screen)
        assert not list(by_simulation(fitter, fitter.nominal()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "place", "values"),
    [
        ("joint_offset", ("fl_hip",), {"offset": -0.07}),
        ("ground_friction", (), {"ratio": -0.8}),
        ("terrain_tilt", (), {"roll": 0.05, "pitch": 0.03}),
    ],
)
def test_a_gross_cause_is_found_by_simulation_though_small_deviations_imitate_it(
    effect: str, place: tuple[str, ...], values: dict[str, float], quadruped: Case
) -> None:
    case = logged(logged(quadruped, []), [(effect, place, values)])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(
            simulator, comparison, range(len(case.runs)), (effect, "com_offset", "motor_gain", "external_force")
        )
        fitter = Fitter(screen)
        best = max(by_simulation(fitter, fitter.nominal()), key=lambda p: p.foretold)
    (cause,) = best.causes
    assert (cause.candidate.effect, cause.candidate.place) == (effect, place)
    assert best.foretold > 50
    assert all(0.25 < cause.named[name] / true < 2 for name, true in values.items())


@pytest.mark.slow
def test_what_a_finer_step_does_is_no_gap(quadruped: Case) -> None:
    case = logged(logged(quadruped, []), [("time_step", (), {"finer": 0.5})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), ("armature",))
        nominal = Fitter(screen).nominal()
        step = screen.index["time_step", (), "finer"]
        assert deviations(screen, nominal)[step] > 0
        never = np.where(np.arange(len(nominal.prior)) == step, 1e-9, nominal.prior)
        assert screen.misfit(nominal.evidence, never)[0] > screen.misfit(nominal.evidence, nominal.prior)[0] + 1


def recover(name: str, case: Case) -> None:
    effect = EFFECTS[name]
    with Simulator(case, CONFIG) as simulator:
        place = effect.places(simulator.context)[0]
        names = effect.variants[0] or tuple(p.name for p in effect.parameters(simulator.context, place))
        first = next(p for p in effect.parameters(simulator.context, place) if p.name == names[0])
    value = SIZE.get(name, 1.5) * first.step
    case = logged(case, [(name, place, {first.name: value})])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), (name,))
        fitter = Fitter(screen)
        nominal = fitter.nominal()
        candidate = next(c for c in screen.candidates if c.place == place and c.names[0] == first.name)
        A, b, _ = marginal(nominal.evidence, nominal.prior, np.inf)
        estimate = log_evidence(A, b, candidate.directions, slab(candidate))[1]
        begin, *more = starts(screen, candidate, estimate)
        fit = fitter.fit([Cause(candidate, tuple(begin))], more, rough=True)
        assert fit is not None
        fit = fitter.fit(fit.causes, iterations=6) or fit
        defaults = {p.name: p.default for p in effect.parameters(simulator.context, place)} | {first.name: value}
        true = fitter.fit([Cause(candidate, tuple(defaults[n] for n in candidate.names))], iterations=1)
        assert true is not None
        assert fit.misfit < true.misfit + 0.1 * (nominal.misfit - true.misfit)
        assert fit.causes[0].named[first.name] == pytest.approx(value, rel=0.2)


def test_nothing_is_found_where_nothing_is(arm: Case) -> None:
    case = logged(arm, [])
    with Simulator(case, CONFIG) as simulator:
        comparison = Comparison(case, simulator.channels, simulator.simulate(), CONFIG)
        screen = Screen(simulator, comparison, range(len(case.runs)), ("payload", "coulomb_friction", "command_delay"))
        assert not is_gap(leftover(screen, Fitter(screen).nominal()))


def test_the_library_names_every_effect_that_its_files_define() -> None:
    files = [import_module(f"{effects.__name__}.{m.name}") for m in iter_modules(effects.__path__)]
    assert {e.name for file in files for e in vars(file).values() if isinstance(e, Effect)} == set(EFFECTS)
