"""Actuators whose force follows their command with a lag: rotors, slow loops, filters of set-points."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.answer.patch import patched_xml
from realsim.gap.simulation.control import lagged
from realsim.gap.simulation.simulate import Simulator
from tests.truths.drone import DRONE, fly
from tests.truths.written import write_case

CONFIG = DiagnoseConfig(threads=1, bootstrap=50, effects=("actuator_lag", "command_delay", "motor_gain", "armature"))
HINGE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="hinge" axis="0 1 0" damping="0.1" armature="0.002"/>
<inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.004 0.004 0.001"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def with_lag(xml: str, lag: float) -> str:
    """The model with MuJoCo's own first-order filter on its actuators."""
    spec = mujoco.MjSpec.from_string(xml)
    for actuator in spec.actuators:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.dynprm = [lag, *[0.0] * (len(actuator.dynprm) - 1)]
    spec.compile()
    return str(spec.to_xml())


def hinges(folder: Path, real: str, model: str = HINGE) -> Case:
    """Runs of a hinge that is driven by sums of waves, as `real` moves, against `model`."""
    runs, rng, robot = {}, np.random.default_rng(3), mujoco.MjModel.from_xml_string(real)
    time = np.arange(0.0, 3.0, 0.01)
    for k in range(3):
        waves = rng.uniform(0.5, 4.0, 3), rng.uniform(0, 6, 3)
        command = 0.5 * np.sum(
            [np.sin(2 * np.pi * f * time + p) - np.sin(p) for f, p in zip(*waves, strict=True)], axis=0
        )
        data, place = mujoco.MjData(robot), []
        for u in command:
            place.append(data.qpos[0] + rng.normal(0, 2e-4))
            data.ctrl[:] = u
            mujoco.mj_step(robot, data, 5)
        runs[f"run_{k}"] = {"time": time, "command": command[:, None], "joint_pos": np.array(place)[:, None]}
    return load_case(write_case(folder, model, runs, command_kind="torque"))


def flights(folder: Path, lag: float, own: float = 0.0) -> Case:
    """Of a drone whose rotors lag, held up by its controller, against a model whose rotors have a lag of their own."""
    rng, robot = np.random.default_rng(0), mujoco.MjModel.from_xml_string(with_lag(DRONE, lag) if lag else DRONE)
    flown = {f"flight_{k}": fly(robot, rng, seconds=2.0) for k in range(3)}
    model = with_lag(DRONE, own) if own else DRONE
    return load_case(write_case(folder, model, flown, command_kind="torque", imu_site="imu"))


@given(lag=st.floats(0.002, 0.3), dt=st.floats(5e-4, 0.01))
def test_a_step_is_answered_by_an_exponential(lag: float, dt: float) -> None:
    """Mean over each step of 1 - exp(-t / lag), by its integral; nothing before, and all of it in the end."""
    edges = dt * np.arange(51)
    whole = edges + lag * np.exp(-edges / lag)
    np.testing.assert_allclose(lagged(np.r_[0.0, np.ones(50)], lag, dt)[1:], np.diff(whole) / dt, atol=1e-9)
    assert lagged(np.r_[0.0, np.ones(200)], lag, lag / 10)[-1] == pytest.approx(1.0, abs=1e-6)


@given(values=st.lists(st.floats(-5, 5), min_size=2, max_size=40), lag=st.floats(1e-6, 1.0))
def test_a_lag_keeps_what_is_constant_and_never_overshoots(values: list[float], lag: float) -> None:
    found = lagged(np.array(values), lag, 0.002)
    assert found.min() >= min(values) - 1e-9
    assert found.max() <= max(values) + 1e-9
    np.testing.assert_allclose(lagged(np.full(9, values[0]), lag, 0.002), values[0])


def test_the_lag_of_a_model_is_simulated(tmp_path: Path) -> None:
    """MuJoCo's filter, whose state no log has, becomes a lag of the commands: the same motion."""
    own = with_lag(HINGE, 0.05)
    case = hinges(tmp_path / "case", own, own)
    assert case.whole
    with Simulator(case, CONFIG) as simulator:
        for run, y in zip(case.runs, simulator.simulate(), strict=True):
            place = run.signals["joint_pos"]
            half_a_step = (
                1e-3 * np.abs(np.gradient(place[:, 0], 0.01)).max()
            )  # MuJoCo's force is that of the step before
            np.testing.assert_allclose(y[:, :1], place, atol=1.1 * half_a_step + 1e-3)
            assert half_a_step < 0.02 < np.std(place)


@pytest.mark.parametrize("own", [0.0, 0.02])
def test_the_patch_has_the_lag(own: float, tmp_path: Path) -> None:
    """In model.xml it is that of the actuators, beside what they had."""
    xml = with_lag(HINGE, own) if own else HINGE
    with Simulator(hinges(tmp_path / "case", xml, xml), CONFIG) as simulator:
        settings = [("actuator_lag", (), {"lag": 0.03})]
        text = patched_xml(simulator, settings)
    assert "not in this file" not in text
    model = mujoco.MjModel.from_xml_string(text)
    assert model.actuator_dynprm[0, 0] == pytest.approx(own + 0.03)
    assert model.actuator_actearly[0]


def test_recovered_on_a_hinge_and_told_from_a_delay(tmp_path: Path) -> None:
    found = diagnose(hinges(tmp_path / "case", with_lag(HINGE, 0.04)), CONFIG)
    (cause,) = found.causes
    assert cause["effect"] == "actuator_lag"
    assert cause["parameters"]["lag"]["value"] == pytest.approx(0.04, abs=0.002)
    assert found.verdict == "identified"


def test_a_lag_that_the_model_has_too_much_of(tmp_path: Path) -> None:
    found = diagnose(hinges(tmp_path / "case", with_lag(HINGE, 0.02), with_lag(HINGE, 0.06)), CONFIG)
    (cause,) = found.causes
    assert cause["effect"] == "actuator_lag"
    assert cause["parameters"]["lag"]["value"] == pytest.approx(-0.04, abs=0.002)


def test_a_delay_is_no_lag(tmp_path: Path) -> None:
    case = hinges(tmp_path / "case", HINGE)
    late = tuple(
        replace(run, command=np.concatenate([run.command[2:], run.command[-1:].repeat(2, axis=0)])) for run in case.runs
    )
    (cause,) = diagnose(case.with_runs(late), CONFIG).causes
    assert cause["effect"] == "command_delay"


def test_not_named_where_the_model_has_it(tmp_path: Path) -> None:
    config = replace(CONFIG, effects=("actuator_lag", "link_inertia", "thrust_gain"))
    assert diagnose(flights(tmp_path / "case", 0.04, own=0.04), config).verdict == "no_gap"
