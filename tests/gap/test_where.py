"""Where the gap lies: states from logs, short predictions, equations of motion, bins that stand out."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap import Case, DiagnoseConfig, load_case
from realsim.gap.case.motion import estimate, smooth
from realsim.gap.inference.evidence.inverse import base_wrench, torque_residual
from realsim.gap.inference.evidence.shooting import shoot
from realsim.gap.inference.evidence.where import by_horizon, evidence, localise, significant
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.simulation.simulate import Simulator
from tests.truths.written import write_case

from .truth import FINE, Truth

CONFIG = DiagnoseConfig(threads=1)
FRICTION = [("coulomb_friction", ("elbow",), {"friction": 0.5})]


def logged(simulator: Simulator, settings: Any, noise: float = 1e-5) -> Case:
    """The case as a robot with these settings would have logged it."""
    rng = np.random.default_rng(0)
    runs = []
    for run, y in zip(simulator.case.runs, simulator.simulate(settings), strict=True):
        signals: dict[str, Any] = {}
        for i, channel in enumerate(simulator.channels):
            if channel.signal != "base_rot":
                column = y[:, i] + noise * rng.normal(size=len(y))
                signals.setdefault(channel.signal, []).append(column)
        arrays = {k: np.stack(v, axis=1) for k, v in signals.items()}
        runs.append(replace(run, signals=run.signals | arrays))
    return simulator.case.with_runs(tuple(runs))


@pytest.fixture(scope="module")
def arm(made: Callable[..., Path]) -> Iterator[Simulator]:
    with Simulator(load_case(made(Truth(), FINE, torque="measured")), CONFIG) as found:
        yield found


@pytest.fixture(scope="module")
def sticky(arm: Simulator) -> Iterator[Simulator]:
    with Simulator(logged(arm, FRICTION), CONFIG) as found:
        yield found


def test_derivatives_of_a_sine_with_holes_and_jitter() -> None:
    rng = np.random.default_rng(0)
    time = np.sort(rng.uniform(0, 3, 1500))
    values = np.sin(6 * time)[:, None] + 1e-4 * rng.normal(size=(1500, 1))
    values[rng.random(1500) < 0.05] = np.nan
    grid = np.arange(0.1, 2.9, 0.002)
    value, rate, change = smooth(grid, time, values)
    inner = slice(30, -30)
    assert np.abs(value[inner, 0] - np.sin(6 * grid[inner])).max() < 1e-3
    assert np.abs(rate[inner, 0] - 6 * np.cos(6 * grid[inner])).max() < 0.1
    assert np.abs(change[inner, 0] + 36 * np.sin(6 * grid[inner])).max() < 4


def test_states_of_a_simulated_run_are_found(sticky: Simulator) -> None:
    motion = estimate(sticky.case, sticky.case.runs[0])
    run = sticky.case.runs[0]
    logged_speed = np.stack([np.interp(motion.time, run.time, c) for c in run.signals["joint_vel"].T], axis=1)
    error = motion.qvel - logged_speed
    assert motion.good.mean() > 0.95
    assert np.sqrt(np.mean(error**2)) < 0.06 * np.sqrt(np.mean(logged_speed**2))


def test_values_that_make_no_body_are_an_error_by_name(sticky: Simulator) -> None:
    with pytest.raises(GapError, match="does not compile"):
        shoot(sticky, [("payload", ("fore",), {"mass": -100.0})])


def test_predictions_of_the_right_model_stay_at_the_noise(sticky: Simulator) -> None:
    wrong, right = shoot(sticky), shoot(sticky, FRICTION)
    assert wrong.labels == ("one sample", "20 ms", "100 ms", "500 ms")
    assert wrong.errors.shape[0] > 20
    before, after = wrong.rms("joint_pos"), right.rms("joint_pos")
    assert np.all(np.diff(before) > 0)
    assert after[2] < 0.5 * before[2]
    assert after[3] < 0.5 * before[3]
    assert before[0] == pytest.approx(after[0], abs=5e-4)  # one sample ahead both know the state


@pytest.mark.parametrize(
    "setting",
    [
        ("backlash", ("elbow",), {"gap": 0.04}),
        ("joint_offset", ("elbow",), {"offset": 0.1}),
        ("observation_delay", (), {"delay": 0.02}),
        ("command_delay", (), {"delay": 0.02}),
        ("load_friction", ("elbow",), {"ratio": 0.3}),
    ],
)
def test_shots_know_wrappers_and_rotors(arm: Simulator, setting: Any) -> None:
    with Simulator(logged(arm, [setting]), CONFIG) as robot:
        before, after = (shoot(robot, s).rms("joint_pos") for s in ([], [setting]))
    assert after[-1] < 0.6 * before[-1]


def test_torque_residual_names_friction(sticky: Simulator) -> None:
    found = torque_residual(sticky)
    assert found is not None
    shoulder, elbow = found.terms
    assert elbow["what"] == "against the velocity, of constant size"
    assert elbow["value"] == pytest.approx(0.5, rel=0.2)
    assert elbow["explains"] > 0.6
    assert found.rms[0] < 0.3 * np.std(sticky.case.runs[0].signals["joint_torque"][:, 0])
    assert shoulder["explains"] < 0.6


def test_what_a_stop_bears_is_no_missing_torque(arm: Simulator) -> None:
    """The commands press the elbow against a stop that the model has."""
    spec = arm.case.spec.copy()
    spec.joint("elbow").limited = True
    spec.joint("elbow").range = [-10.0, float(np.nanmedian(arm.case.runs[0].signals["joint_pos"][:, 1]))]
    with Simulator(replace(arm.case, spec=spec, model=spec.copy().compile()), CONFIG) as robot:
        pressed = logged(robot, [])
    with Simulator(pressed, CONFIG) as robot:
        found = torque_residual(robot)
    assert found is not None
    assert np.isnan(found.residual[:, 1]).mean() > 0.1
    assert np.isfinite(found.residual[:, 0]).all()
    assert found.rms[1] < 0.3 * np.std(pressed.runs[0].signals["joint_torque"][:, 1])


def test_a_joint_without_a_torque_sensor_lacks_no_torque(sticky: Simulator) -> None:
    whole = torque_residual(sticky)
    runs = [replace(r, signals=r.signals | {"joint_torque": r.signals["joint_torque"] * [1, np.nan]})
            for r in sticky.case.runs]  # fmt: skip
    with Simulator(sticky.case.with_runs(tuple(runs)), CONFIG) as robot:
        found = torque_residual(robot)
    assert whole is not None
    assert found is not None
    assert found.joints == ("shoulder",)
    assert found.rms == pytest.approx(whole.rms[:1])
    assert found.share == pytest.approx(whole.share[:1])
    assert found.terms[0]["what"] == whole.terms[0]["what"]


def test_no_torque_at_all_is_no_residual(arm: Simulator) -> None:
    """Both joints are at a stop throughout."""
    spec = arm.case.spec.copy()
    for joint in ("shoulder", "elbow"):
        spec.joint(joint).limited, spec.joint(joint).range = True, [-20.0, -10.0]
    with Simulator(replace(arm.case, spec=spec, model=spec.copy().compile()), CONFIG) as robot:
        assert torque_residual(robot) is None


def quadruped(folder: Path) -> Case:
    legs, servos, names = [], [], []
    for leg, x, y in (("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("hl", -0.2, 0.1), ("hr", -0.2, -0.1)):
        legs.append(
            f'<body name="{leg}_a" pos="{x} {y} 0"><joint name="{leg}_hip" axis="1 0 0" armature="0.01"/>'
            f'<geom type="sphere" size=".04" mass=".5" contype="0" conaffinity="0"/>'
            f'<body name="{leg}_b"><joint name="{leg}_thigh" axis="0 1 0" armature="0.01"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5" contype="0" conaffinity="0"/>'
            f'<body name="{leg}_c" pos="0 0 -.2"><joint name="{leg}_calf" axis="0 1 0" armature="0.01"/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".01" mass=".1" contype="0" conaffinity="0"/>'
            f'<geom type="sphere" size=".02" pos="0 0 -.2" mass=".05"/></body></body></body>'
        )
        names += [f"{leg}_{k}" for k in ("hip", "thigh", "calf")]
    servos = [f'<position name="{n}_servo" joint="{n}" kp="120" kv="4"/>' for n in names]
    xml = (
        '<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><geom name="floor" type="plane" '
        'size="5 5 .1"/><body name="trunk" pos="0 0 .33"><freejoint/><geom type="box" size=".25 .1 .05" mass="6" '
        f'contype="0" conaffinity="0"/>{"".join(legs)}</body></worldbody>'
        f"<actuator>{''.join(servos)}</actuator></mujoco>"
    )
    t = np.arange(400) * 0.01
    bend = 0.7 + 0.15 * np.sin(4 * t) * np.clip(t, 0, 1)
    q = np.tile(np.stack([0 * t, bend, -2 * bend], axis=1), (1, 4))
    pose = np.tile([0.0, 0, 0.4 * np.cos(0.7) + 0.02], (400, 1))
    run = {"time": t, "command": q, "joint_pos": q, "base_pos": pose, "base_quat": np.tile([1.0, 0, 0, 0], (400, 1))}
    return load_case(write_case(folder, xml, dict.fromkeys("abc", run)))


def test_a_payload_shows_in_the_rows_without_motors_and_friction_does_not(tmp_path: Path) -> None:
    with Simulator(quadruped(tmp_path / "case"), CONFIG) as simulator:
        masses = []
        for setting in (
            [],
            [("payload", ("trunk",), {"mass": 1.5})],
            [("viscous_friction", ("fl_calf",), {"damping": 2.0})],
        ):
            robot = logged(simulator, setting)
            # The orientation is a rotation vector in the comparison; these runs hardly turn, so it is left as it was.
            with Simulator(robot, CONFIG) as heavier:
                wrench = base_wrench(heavier)
                assert wrench is not None
                masses.append(wrench.mass)
    assert masses[0] == pytest.approx(0, abs=0.15)
    assert masses[1] == pytest.approx(1.5, rel=0.2)
    assert masses[2] == pytest.approx(masses[0], abs=0.15)


def test_a_leg_without_a_torque_sensor_leaves_the_wrench(tmp_path: Path) -> None:
    """What its foot bears is unknown, so part of a payload could be; but nothing is made up where nothing lacks."""
    case = replace(quadruped(tmp_path / "case"), torque_kind="measured")
    with Simulator(case, CONFIG) as simulator:
        runs = []
        for run, y in zip(case.runs, simulator.simulate(), strict=True):
            position = [i for i, c in enumerate(simulator.channels) if c.signal == "joint_pos"]
            place = [i for i, c in enumerate(simulator.channels) if c.signal == "base_pos"]
            torque = 120 * (run.command - y[:, position]) - 4 * np.gradient(y[:, position], run.time, axis=0)
            torque[:, -1] = np.nan
            arrays = {"joint_pos": y[:, position], "base_pos": y[:, place], "joint_torque": torque}
            runs.append(replace(run, signals=run.signals | arrays))
    with Simulator(case.with_runs(tuple(runs)), CONFIG) as simulator:
        wrench = base_wrench(simulator)
    assert wrench is not None
    assert wrench.mass == pytest.approx(0, abs=0.15)


# ---------------------------------------------------------------- bins


def test_false_names_are_held_down() -> None:
    assert significant([]) == []
    assert significant([0.5, 0.9, 0.3]) == [False] * 3
    # Worked by hand at 10 %: the limits are 0.025, 0.05, 0.075, 0.1; 0.07 <= 0.075 lets the three smallest pass.
    assert significant([0.07, 0.2, 0.001, 0.06]) == [True, False, True, True]
    rng = np.random.default_rng(0)
    assert np.mean([any(significant(rng.random(50).tolist())) for _ in range(400)]) < 0.16


@pytest.fixture(scope="module")
def even(arm: Simulator) -> tuple[Comparison, list[Any], list[Any]]:
    """Residuals that are nothing but the floor."""
    comparison = Comparison(arm.case, arm.channels, arm.simulate(), CONFIG)
    rng = np.random.default_rng(1)
    floors = [np.sqrt(comparison.floor(i)) for i in range(len(arm.case.runs))]
    return comparison, [f * rng.normal(size=f.shape) for f in floors], arm.nominal_tracks


def test_noise_has_no_place(even: tuple[Comparison, list[Any], list[Any]]) -> None:
    comparison, residuals, tracks = even
    entries, shares = localise(comparison, residuals, range(len(residuals)), tracks)
    assert entries == []
    assert shares.sum() == pytest.approx(1.0)


def test_an_error_of_one_joint_is_listed_there(even: tuple[Comparison, list[Any], list[Any]]) -> None:
    comparison, residuals, tracks = even
    elbow = next(i for i, c in enumerate(comparison.channels) if c.signal == "joint_pos" and c.label == "elbow")
    worse = []
    for i, (r, track) in enumerate(zip(residuals, tracks, strict=True)):
        settle, dt = track["settle"]
        at = ((comparison.times[i] + settle) / dt).astype(int).clip(0, len(track["vel"]) - 1)
        forward = track["vel"][at, 1] > 0.05 * np.abs(track["vel"][:, 1]).max()
        worse.append(r.copy())
        worse[-1][forward, elbow] *= 8
    entries, shares = localise(comparison, worse, range(len(worse)), tracks)
    assert {(e["signal"], e["joint"]) for e in entries} == {("joint_pos", "elbow")}
    assert sum(e["share"] for e in entries) <= shares.sum() + 1e-9


def test_a_single_event_is_listed_and_a_short_log_too(even: tuple[Comparison, list[Any], list[Any]]) -> None:
    comparison, residuals, tracks = even
    event = [r.copy() for r in residuals]
    event[0][60:70, 0] *= 60
    entries, _ = localise(comparison, event, range(len(event)), tracks)
    assert entries[0]["share"] > 0.3
    short = [8 * r for r in residuals[:1]]
    entries, _ = localise(comparison, short, [0], tracks)
    assert len(entries) > 5


def test_evidence_is_plain_data(sticky: Simulator) -> None:
    nominal = sticky.simulate()
    comparison = Comparison(sticky.case, sticky.channels, nominal, CONFIG)
    residuals = [comparison.residual(i, y) for i, y in enumerate(nominal)]
    found = json.loads(json.dumps(evidence(sticky, comparison, residuals)))
    assert set(found["error_by_horizon"]["joint_pos"]) == {"one sample", "20 ms", "100 ms", "500 ms", "whole run"}
    assert found["torque_residual"]["elbow"]["unit"] == "N m"
    assert "base_wrench" not in found


def test_change_by_horizon_shrinks(sticky: Simulator) -> None:
    found = by_horizon([shoot(sticky, runs=[0, 1]), shoot(sticky, FRICTION, [0, 1])])["joint_pos"]
    assert list(found) == ["one sample", "20 ms", "100 ms", "500 ms"]
    assert found["500 ms"]["after"] < 0.5 * found["500 ms"]["before"]  # type: ignore[operator]
