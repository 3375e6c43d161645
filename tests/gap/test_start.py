"""How runs begin: at rest they are simulated from rest, whatever the sensors say; in motion, from the logged state."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.case.health import examine
from realsim.gap.simulation.simulate import Simulator
from realsim.gap.simulation.start import first_fit
from tests.truths.written import write_case

from .truth import ARM, PENDULUM, Truth

CONFIG = DiagnoseConfig(threads=1)
RATE, SAMPLES, NOISE = 125, 500, 2e-4


def swinging(
    folder: Path, xml: str, *, given: bool = False, speed: float = 4.0, away: float = 0.4, offset: float = 0.0
) -> Path:
    """A case whose runs are cut out of motion: by the simulator itself, at a finer time step."""
    rng = np.random.default_rng(1)
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 0.0005
    runs = {}
    time = np.arange(SAMPLES) / RATE + rng.uniform(0, 2e-4, SAMPLES)
    for k in range(3):
        turns = rng.uniform([0.4, 0.0], [1.2, 6.0], (model.njnt, 2))
        command = np.stack([0.6 * np.sin(2 * np.pi * f * time + p) for f, p in turns], axis=1)
        data = mujoco.MjData(model)
        data.qpos[:] = command[0] + away * rng.choice([-1, 1], model.njnt)
        data.qvel[:] = speed * rng.choice([-1, 1], model.njnt)
        state = {"init_qpos": data.qpos + offset, "init_qvel": data.qvel.copy()} if given else {}
        position, velocity = np.zeros_like(command), np.zeros_like(command)
        for i, now in enumerate(command):
            position[i], velocity[i], data.ctrl[:] = data.qpos, data.qvel, now - offset
            mujoco.mj_step(model, data, 16)
        position += offset + rng.normal(0, NOISE, position.shape)
        velocity += rng.normal(0, 25 * NOISE, velocity.shape)
        runs[f"run_{k}"] = {"time": time, "command": command, "joint_pos": position, "joint_vel": velocity} | state
    return write_case(folder, xml, runs)


def missed(simulator: Simulator, settings: list[Any] | None = None) -> float:
    """Largest error of a joint position, rad."""
    joints = len(simulator.case.joint_names)
    pairs = zip(simulator.case.runs, simulator.simulate(settings or []), strict=True)
    return float(max(np.nanmax(np.abs(r.signals["joint_pos"] - y[:, :joints])) for r, y in pairs))


@pytest.mark.parametrize("xml", [PENDULUM, ARM])
@pytest.mark.parametrize("given", [True, False])
def test_a_run_in_full_swing_begins_in_the_state_of_the_log(xml: str, given: bool, tmp_path: Path) -> None:
    case = load_case(swinging(tmp_path / "case", xml, given=given))
    with Simulator(case, CONFIG) as simulator:
        assert {s.kind for s in simulator.starts} == {"given" if given else "log"}
        assert missed(simulator) < 0.03  # from rest: 0.4
        assert all(t["settle"][0] == 0 for t in simulator.nominal_tracks)


def test_a_robot_let_go_from_another_posture_begins_there(tmp_path: Path) -> None:
    case = load_case(swinging(tmp_path / "case", PENDULUM, speed=0.0, away=0.3))
    with Simulator(case, CONFIG) as simulator:
        assert {s.kind for s in simulator.starts} == {"log"}
        assert missed(simulator) < 0.03


@pytest.mark.parametrize("given", [True, False])
def test_the_offset_of_an_encoder_is_in_the_state_that_it_read(given: bool, tmp_path: Path) -> None:
    case = load_case(swinging(tmp_path / "case", PENDULUM, given=given, offset=0.1))
    with Simulator(case, CONFIG) as simulator:
        assert all(s.moving and s.encoders for s in simulator.starts)
        assert missed(simulator, [("joint_offset", ("swing",), {"offset": 0.1})]) < 0.03


def test_a_late_encoder_read_the_state_of_earlier(tmp_path: Path) -> None:
    case = load_case(swinging(tmp_path / "case", PENDULUM))
    late = 5  # samples; the log's own clock is shifted, so that its readings are late
    runs = []
    for run in case.runs:
        signals = {k: v[:-late] for k, v in run.signals.items()}
        runs.append(replace(run, time=run.time[late:] - run.time[late], command=run.command[late:], signals=signals))
    with Simulator(case.with_runs(tuple(runs)), CONFIG) as simulator:
        assert all(s.moving for s in simulator.starts)
        right = [("observation_delay", (), {"delay": late / RATE})]
        assert missed(simulator, right) < 0.5 * missed(simulator)


AT_REST = {
    "nothing": Truth(),
    "offset": Truth(offset={"elbow": 0.08}),
    "load": Truth(mass={"fore": (1.0, (0.0, 0.0, -0.3))}),
    "friction": Truth(coulomb={"shoulder": 3.0}),
    "backlash": Truth(backlash={"elbow": 0.05}),
    "delay": Truth(delay=0.03),
    "force": Truth(force={"fore": (12.0, 0.0, 0.0)}),
    "weak": Truth(kp={"shoulder": 0.5}),
}


@pytest.mark.parametrize("name", AT_REST)
def test_a_robot_at_rest_stays_at_rest_whatever_its_gap(name: str, made: Callable[..., Path]) -> None:
    case = load_case(made(AT_REST[name], runs=2))
    abrupt = case.with_runs(tuple(r.part(r.time > 0.49) for r in case.runs))  # whose commands move at once
    for one in (case, abrupt):
        with Simulator(one, CONFIG) as simulator:
            assert {s.kind for s in simulator.starts} == {"rest"}
            settled = [t["settle"][0] for t in simulator.nominal_tracks]
            assert settled == pytest.approx([CONFIG.settle_seconds] * len(one.runs))


def test_a_given_speed_that_the_log_contradicts_is_not_believed(made: Callable[..., Path]) -> None:
    case = load_case(made(Truth(), runs=2))
    lying = case.with_runs(tuple(replace(r, init_qvel=np.full(2, 2.0)) for r in case.runs))
    with Simulator(lying, CONFIG) as simulator:
        assert {s.kind for s in simulator.starts} == {"rest"}


def test_health_says_how_each_run_was_started(tmp_path: Path, made: Callable[..., Path]) -> None:
    with Simulator(load_case(swinging(tmp_path / "case", ARM)), CONFIG) as simulator:
        found = examine(simulator)
    assert set(found["start"]["runs"]) == {"run_0", "run_1", "run_2"}
    assert all("from the state of the first samples" in how for how in found["start"]["runs"].values())
    assert any("simulated from the state of the first samples" in w for w in found["warnings"])
    with Simulator(load_case(made(Truth(), runs=2)), CONFIG) as simulator:
        found = examine(simulator)
    assert all("from rest" in how for how in found["start"]["runs"].values())


@pytest.mark.parametrize("given", [True, False])
def test_a_perfect_simulator_of_a_swinging_robot_has_no_gap(given: bool, tmp_path: Path) -> None:
    case = load_case(swinging(tmp_path / "case", PENDULUM, given=given))
    effects = ("coulomb_friction", "viscous_friction", "command_delay", "payload", "armature")
    found = diagnose(case, DiagnoseConfig(threads=1, effects=effects, bootstrap=50))
    assert found.verdict == "no_gap"
    assert found.causes == ()


def test_the_first_fit_is_exact_for_parabolas() -> None:
    time = np.sort(np.random.default_rng(0).uniform(0, 0.3, 60))
    values = np.stack([1 - 2 * time + 7 * time**2, 3 * time], axis=1)
    place, slope = first_fit(time - time[0], values, 2)
    exact = np.stack([1 - 2 * time[0] + 7 * time[0] ** 2, 3 * time[0]])
    np.testing.assert_allclose(place, exact, atol=1e-9)
    np.testing.assert_allclose(slope, [-2 + 14 * time[0], 3], atol=1e-6)
