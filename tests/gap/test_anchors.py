"""Replays that would run away go on from states of the log; all others are as they were."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.gap import Case, DiagnoseConfig, diagnose, load_case
from realsim.gap.answer.patch import apply_patch
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.free_starts import free_starts
from realsim.gap.simulation.anchors import LEAST
from realsim.gap.simulation.simulate import Simulator
from tests.truths.drone import DRONE
from tests.truths.written import write_case

from .searching import flights, simulator_of
from .truth import Truth

CONFIG = DiagnoseConfig(threads=1, bootstrap=50)
EFFECTS = replace(CONFIG, effects=("payload", "com_offset", "thrust_gain"))


@pytest.fixture(scope="module")
def arm(made: Callable[..., Path]) -> Case:
    return load_case(made(Truth(), runs=1))


def errors(case: Case) -> tuple[list[float], list[float]]:
    """Mean squares in units of the floor, a run: of the replay, and with the states of its parts fitted."""
    with Simulator(case, CONFIG) as simulator:
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, CONFIG)

        def left() -> list[float]:
            return [
                float(np.nanmean(comparison.residual(i, y) ** 2 / comparison.floor(i))) for i, y in enumerate(nominal)
            ]

        before = left()
        free_starts(simulator, comparison)
        return before, left()


def test_a_drone_goes_on_from_the_log_before_a_small_error_has_grown(hovering: Case) -> None:
    with Simulator(hovering, CONFIG) as simulator:
        for start, run in zip(simulator.starts, hovering.runs, strict=True):
            at = np.array([0.0, *(a.time for a in start.anchors), run.duration])
            assert len(start.anchors) > 0
            assert (np.diff(at) >= LEAST - 0.01).all()
            assert np.diff(at).max() < 2.0  # a tilt of 1 mrad is 10 mm after 1.4 s


def test_what_noise_in_those_states_does_is_no_error(hovering: Case) -> None:
    before, after = errors(hovering)
    assert max(after) < 2.0 < 10.0 < max(before)


def test_a_robot_whose_errors_do_not_grow_is_replayed_as_a_whole(made: Callable[..., Path]) -> None:
    case = load_case(made(Truth(armature={"elbow": 0.2})))
    with Simulator(case, CONFIG) as simulator:
        assert not any(start.anchors for start in simulator.starts)
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, CONFIG)
        kept = [comparison.residual(i, y) for i, y in enumerate(nominal)]
        free_starts(simulator, comparison)
        for i, y in enumerate(nominal):
            np.testing.assert_array_equal(comparison.residual(i, y), kept[i])


PENDULUM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="rod" pos="0 0 1">
<joint name="swing" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.4" mass="0.7" diaginertia="0.006 0.006 0.001"/></body></worldbody>
<actuator><motor name="m" joint="swing"/></actuator></mujoco>"""


def test_what_falls_in_one_run_begins_in_the_log_in_all(tmp_path: Path) -> None:
    """Just below upright, held by friction that the model lacks: no command keeps the model there."""
    time = np.arange(0.0, 2.0, 0.01)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data, swing, noise = mujoco.MjData(model), [], np.random.default_rng(0).normal(0, 1e-3, (2, len(time), 1))
    data.qpos[0] = 3.05
    for _ in time:
        swing.append(data.qpos.copy())
        mujoco.mj_step(model, data, 5)
    still, held = np.zeros((len(time), 1)), np.full((len(time), 1), 3.12)
    places = {"falls": np.array(swing) + noise[0], "held": held + noise[1], "hangs": still + noise[1]}
    runs = {name: {"time": time, "command": still, "joint_pos": at} for name, at in places.items()}
    with Simulator(load_case(write_case(tmp_path, PENDULUM, runs, command_kind="torque")), CONFIG) as simulator:
        falls, hangs, held_up = simulator.starts
    assert {s.kind for s in (falls, held_up, hangs)} == {"log"}
    assert held_up.anchors  # the model falls there, too
    assert not hangs.anchors


@settings(max_examples=20, deadline=None)
@given(scale=st.lists(st.floats(-5, 5), min_size=4, max_size=4))
def test_states_of_parts_explain_what_is_a_sum_of_their_slopes(arm: Case, scale: list[float]) -> None:
    """A law: residual and change do not depend on the states that parts begin in, to first order."""
    simulator = simulator_of(arm)
    nominal = simulator.simulate()
    comparison = Comparison(arm, simulator.channels, nominal, CONFIG)
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(*nominal[0].shape, 2))
    parts = (np.arange(len(comparison.times[0])) > 20).astype(int)
    comparison.free_starts(0, slopes, parts)
    part = (np.floor(arm.runs[0].time / CONFIG.bin_seconds) > 20).astype(int)
    moved = nominal[0] + np.einsum("tck,tk->tc", slopes, np.array(scale).reshape(2, 2)[part])
    size = 1e-6 * (1 + np.abs(scale).max())
    np.testing.assert_allclose(comparison.change(0, moved, nominal[0]), 0, atol=size)
    np.testing.assert_allclose(
        comparison.residual(0, moved), comparison.residual(0, nominal[0]), atol=size, equal_nan=True
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "effect", "name"),
    [
        ({"payload": 0.1}, "payload", "mass"),
        ({"com": 0.01}, "com_offset", "x"),
    ],
)
def test_a_drone_is_diagnosed(tmp_path: Path, truth: dict[str, float], effect: str, name: str) -> None:
    """Open loop, the second tumbles within 0.2 s."""
    found = diagnose(flights(tmp_path / "case", runs=2, seconds=1.5, **truth), EFFECTS)
    assert found.verdict == "identified"
    (cause,) = found.causes
    assert cause["effect"] == effect
    assert cause["parameters"][name]["value"] == pytest.approx(next(iter(truth.values())), rel=0.1)


def test_a_weak_rotor_is_told_from_the_others(tmp_path: Path) -> None:
    case = flights(tmp_path / "case", thrust=(0.85, 1, 1, 1), runs=2, seconds=1.5)
    found = diagnose(case, replace(CONFIG, effects=("thrust_gain",)))
    (cause,) = found.causes
    assert cause["actuators"] == ["rotor0"]
    assert cause["parameters"]["ratio"]["value"] == pytest.approx(0.85, abs=0.005)
    spec = mujoco.MjSpec.from_string(DRONE)
    apply_patch(spec, found.patch)
    np.testing.assert_allclose([a.gainprm[0] for a in spec.actuators], [0.85, 1, 1, 1], atol=0.005)


@pytest.mark.slow
def test_a_drone_as_modelled_has_no_gap(tmp_path: Path) -> None:
    assert diagnose(flights(tmp_path / "case", runs=2, seconds=1.5), EFFECTS).verdict == "no_gap"


def test_gusts_that_a_controller_answers_are_no_cause(tmp_path: Path) -> None:
    """Torques that turn nothing, as if the drone were heavier or slower."""
    effects = ("thrust_gain", "link_inertia", "command_delay", "actuator_lag", "com_offset")
    case = flights(tmp_path / "case", runs=5, seconds=2.0, gusts=4.0)
    assert not diagnose(case, replace(CONFIG, effects=effects)).causes
