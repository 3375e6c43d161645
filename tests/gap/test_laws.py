"""Laws of the parts: held commands, rotations, linear algebra of the screen, patches."""

import json

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from realsim.gap import EFFECTS, DiagnoseConfig, apply_patch, diagnose, figures, load_case, run_case
from realsim.gap.case.model.context import kind_of, like_joints
from realsim.gap.case.model.edit import add_point_mass
from realsim.gap.effects.ground import quaternion, rotation
from realsim.gap.inference.likelihood.comparison import Comparison
from realsim.gap.inference.likelihood.linear import bounded, log_evidence, misfit_at, posterior, scaled
from realsim.gap.inference.likelihood.screen import Candidate
from realsim.gap.simulation.sampling import continuous_turn, held_mean, nearest_turn, rotation_from
from realsim.gap.simulation.simulate import Simulator

from .truth import Truth


@given(st.floats(0, 0.05), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_held_mean_keeps_the_integral(delay: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.015, 50))
    values = rng.normal(size=(50, 2))
    grid = np.linspace(time[0], time[-1], 301)
    mean = held_mean(time, values, grid - delay)
    fine = np.linspace(grid[0] - delay, grid[-1] - delay, 200001)
    exact = values[np.clip(np.searchsorted(time, fine, side="right") - 1, 0, 49)].mean(axis=0)
    np.testing.assert_allclose(mean.mean(axis=0), exact, atol=2e-3)


def test_rotation_from_recovers_small_turns() -> None:
    reference = np.array([1.0, 0, 0, 0])
    quat = quaternion(0.1, 0.0)[None]
    np.testing.assert_allclose(rotation_from(quat, reference)[0], [0.1, 0, 0], atol=1e-12)


@given(st.floats(-5.0, 5.0), st.floats(0.0, 0.3), st.integers(0, 20))
@settings(max_examples=30, deadline=None)
def test_a_robot_that_turns_round_shows_no_jump(turn: float, tilt: float, gap: int) -> None:
    t = np.linspace(0, 1, 200)
    angles = np.stack([tilt * np.sin(5 * t), tilt * np.cos(3 * t) - tilt, turn * t], axis=1)
    quat = Rotation.from_euler("xyz", angles).as_quat()[:, [3, 0, 1, 2]]
    logged = rotation_from(quat, quat[0])
    logged[100 : 100 + gap] = np.nan
    path = continuous_turn(logged)
    late = nearest_turn(rotation_from(np.roll(quat, 1, axis=0), quat[0]), path)
    known = np.isfinite(path).all(axis=1)
    assert np.abs(np.diff(path[known], axis=0)).max() < 0.8
    assert np.abs(late - path)[1:][known[1:]].max() < 0.1, "one sample late is a small error at any heading"
    again = Rotation.from_rotvec(path[known]) * Rotation.from_rotvec(logged[known]).inv()
    assert again.magnitude().max() < 1e-6


def test_joints_that_share_a_limit_share_the_figure(made) -> None:
    with Simulator(load_case(made(Truth())), DiagnoseConfig(threads=1)) as simulator:
        peaks = simulator.context.peak_torque
        assert peaks["shoulder"] > 1.3 * peaks["elbow"]
        both = Candidate("torque_limit", (("shoulder",), ("elbow",)), (), np.zeros((0, 1)), ("limit",))
        edit = simulator.edited(both.settings({"limit": 0.6}))
        (limit,) = EFFECTS["torque_limit"].parameters(simulator.context, both.place)
        ranges = [edit.spec.actuator(simulator.context.actuator[j]).forcerange[1] for j in ("shoulder", "elbow")]
        assert ranges == pytest.approx([limit.report(0.6)] * 2)


def test_tilt_matrix_and_quaternion_agree() -> None:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion(0.2, -0.1))
    np.testing.assert_allclose(out.reshape(3, 3), rotation(0.2, -0.1), atol=1e-12)


@given(st.floats(0.1, 5), st.floats(0.01, 2))
@settings(max_examples=20, deadline=None)
def test_a_payload_can_be_taken_off_again(mass: float, added: float) -> None:
    com, inertia, where = np.array([0.1, 0, -0.2]), np.diag([0.02, 0.03, 0.01]), np.array([0.0, 0.1, 0.3])
    loaded = add_point_mass(mass, com, inertia, added, where)
    back = add_point_mass(*loaded, -added, where)
    assert back[0] == pytest.approx(mass)
    np.testing.assert_allclose(back[1], com, atol=1e-9)
    np.testing.assert_allclose(back[2], inertia, atol=1e-9)


def test_posterior_is_ridge_regression() -> None:
    rng = np.random.default_rng(0)
    G, r, prior = rng.normal(size=(200, 5)), rng.normal(size=200), np.array([0.1, 1.0, 0.0, 2.0, 0.5])
    mean, _ = bounded(G.T @ G, G.T @ r, prior, np.inf)
    cov = posterior(G.T @ G, prior)
    keep = prior > 0
    K = G[:, keep]
    exact = np.linalg.solve(K.T @ K + np.diag(1 / prior[keep] ** 2), K.T @ r)
    np.testing.assert_allclose(mean[keep], exact, atol=1e-10)
    np.testing.assert_allclose(
        cov[np.ix_(keep, keep)], np.linalg.inv(K.T @ K + np.diag(1 / prior[keep] ** 2)), atol=1e-10
    )
    assert mean[2] == 0
    assert np.all(cov[2] == 0)


@given(st.integers(0, 10_000), st.floats(0.3, 3))
@settings(max_examples=40, deadline=None)
def test_no_deviation_leaves_its_bound_and_the_free_ones_are_at_their_best(seed: int, most: float) -> None:
    rng = np.random.default_rng(seed)
    G, prior = rng.normal(size=(60, 6)), np.array([0.1, 1.0, 0.0, 2.0, 0.5, 0.2])
    A, b = G.T @ G, G.T @ (G @ rng.normal(size=6))
    x, free = bounded(A, b, prior, most * prior)
    held = (free == 0) & (prior > 0)
    assert np.all(np.abs(x) <= most * prior * (1 + 1e-12))
    np.testing.assert_allclose(np.abs(x[held]), most * prior[held])
    gradient = b - A @ x - np.divide(x, prior**2, out=np.zeros(6), where=prior > 0)
    np.testing.assert_allclose(gradient[free > 0], 0, atol=1e-8)
    within, everything = bounded(A, b, prior, np.inf)
    np.testing.assert_allclose(within, posterior(A, prior) @ b, atol=1e-9)
    assert np.array_equal(everything, prior)
    assert misfit_at(A, b, 1.0, x, prior) >= misfit_at(A, b, 1.0, within, prior) - 1e-9


def test_a_gross_deviation_is_left_to_a_cause() -> None:
    """Two columns alike but for a little: without a bound the everyday one takes all of it."""
    rng = np.random.default_rng(3)
    g = rng.normal(size=400)
    G = np.stack([g, g + 0.02 * rng.normal(size=400)], axis=1)
    A, b = G.T @ G * 1e6, G.T @ (5.0 * G[:, 1]) * 1e6
    prior = np.array([0.1, 0.0])
    x, _ = bounded(A, b, prior, 3 * prior)
    free = bounded(A, b, prior, np.inf)[0]
    left = [float(c @ A @ c) for c in (np.array([0, 5.0]) - x, np.array([0, 5.0]) - free)]
    assert x[0] == pytest.approx(0.3)
    assert left[0] > 100 * left[1]


def test_score_prefers_the_true_direction() -> None:
    rng = np.random.default_rng(1)
    G = rng.normal(size=(300, 4))
    r = G @ np.array([0, 2.0, 0, 0]) + 0.1 * rng.normal(size=300)
    gains = [log_evidence(G.T @ G, G.T @ r, np.eye(4)[:, [i]], np.ones(1))[0] for i in range(4)]
    assert int(np.argmax(gains)) == 1


@pytest.mark.parametrize("at", [[[3]], [[7], [2]], [[2, 7]]])
def test_evidence_of_few_atoms_has_the_digits_of_the_whole_product(at: list[list[int]]) -> None:
    rng = np.random.default_rng(2)
    G, D, size = rng.normal(size=(300, 500)), np.zeros((500, len(at))), np.full(len(at), 0.3)
    for column, rows in enumerate(at):
        D[rows, column] = 1.0
    A, b = G.T @ G, G.T @ rng.normal(size=300)
    estimate = np.linalg.solve(D.T @ A @ D + np.diag(1 / size**2), D.T @ b)
    np.testing.assert_array_equal(log_evidence(A, b, D, size)[1], estimate)


def test_like_joints_are_grouped_by_kind_and_leg() -> None:
    names = ["fl_hip", "fl_knee", "fr_hip", "fr_knee"]
    assert ("fl_hip", "fr_hip") in like_joints(names)
    assert ("fl_hip", "fl_knee") in like_joints(names)
    assert kind_of("left_knee_joint") == kind_of("right_knee_joint")


def test_a_patch_makes_the_model_that_was_diagnosed(made, tmp_path) -> None:
    folder = made(Truth(coulomb={"elbow": 0.4}))
    config = DiagnoseConfig(effects=("coulomb_friction", "command_delay"), bootstrap=50)
    said = run_case(folder, tmp_path / "out", config)
    written = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert written["verdict"] == said["verdict"] == "identified"
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    apply_patch(spec, written["patch"])
    patched = spec.compile()
    value = written["causes"][0]["parameters"]["friction"]["value"]
    assert patched.joint("elbow").frictionloss[0] == pytest.approx(0.25 + value)
    xml = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    assert xml.joint("elbow").frictionloss[0] == pytest.approx(0.25 + value, rel=1e-4)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script src" not in page
    assert "coulomb_friction" in page


def test_the_same_log_gives_the_same_diagnosis(made) -> None:
    case = load_case(made(Truth(coulomb={"elbow": 0.4})))
    case = case.with_runs(case.runs[:2])
    config = DiagnoseConfig(effects=("coulomb_friction",), bootstrap=50)
    first, second = (diagnose(case, config).as_dict() for _ in range(2))
    for found in (first, second):
        for cost in ("seconds", "cpu_seconds"):
            found.pop(cost)
            found["statistics"].pop(cost)
    assert first == second


def test_stribeck_friction_falls_from_rest_to_motion(made) -> None:
    """Friction that holds at rest is S, and what brakes well above the Stribeck velocity is C."""
    case = load_case(made(Truth(), runs=1))
    static, moving, fades = 0.9, 0.4, 0.1
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        joint = simulator.context.driven[0]
        values = {"static_friction": static, "coulomb": moving, "stribeck_velocity": fades}
        nominal = simulator.context.friction(joint)
        model = simulator.edited([("stribeck_friction", (joint,), values)]).spec.compile()
    data = mujoco.MjData(model)
    dof, helper = int(model.joint(joint).dofadr[0]), model.actuator(f"stribeck_{joint}").id
    for speed, expected in ((0.0, static), (fades / 2, (static + moving) / 2), (10 * fades, moving), (-3.0, moving)):
        data.qvel[:] = 0
        data.qvel[dof] = speed
        mujoco.mj_forward(model, data)
        brakes = model.dof_frictionloss[dof] - nominal - np.sign(speed) * data.actuator_force[helper]
        assert brakes == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("no_load", [40.0, 3.0])  # the slope T / v0 below and above the servo's own velocity gain
def test_a_drive_loses_torque_with_speed_only_where_it_drives(no_load: float, made) -> None:
    case = load_case(made(Truth(), runs=1))
    joint = case.joint_names[0]
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        speed, top = simulator.context.speed[joint], simulator.context.torque_range[joint]
        settings = [("torque_speed_limit", (joint,), {"no_load_speed": speed / no_load})]
        models = [simulator.edited(s).spec.compile() for s in ([], settings)]
    assert (-models[0].actuator("shoulder_servo").biasprm[2] < top / no_load) == (no_load < 5)
    for command, v in ((2.0, 1.0), (2.0, -1.0), (-2.0, 1.0), (0.05, 0.5), (0.0, 2.0), (3.0, 0.0)):
        forces = []
        for model in models:
            data = mujoco.MjData(model)
            data.qvel[model.joint(joint).dofadr[0]], data.ctrl[0] = v, command
            mujoco.mj_forward(model, data)
            forces.append(float((data.qfrc_actuator + data.qfrc_passive)[model.joint(joint).dofadr[0]]))
        passive = -0.3 * v
        asked, left = forces[0] - passive, top * (1 - abs(v) / no_load)
        given = np.clip(asked, -top, top) if asked * v <= 0 else np.sign(asked) * min(abs(asked), left)
        assert forces[1] - passive == pytest.approx(given, abs=1e-6)


def test_where_robot_and_simulator_have_parted_nothing_changes(made) -> None:
    case = load_case(made(Truth()))
    with Simulator(case, DiagnoseConfig(threads=1)) as simulator:
        nominal = simulator.simulate()
        comparison = Comparison(case, simulator.channels, nominal, DiagnoseConfig(threads=1))
        comparison._counts[0][30:] = 0
        change = comparison.change(0, nominal[0] + 1.0, nominal[0])
        assert (change[30:] == 0).all()
        assert change[:30][comparison._counts[0][:30] > 0] == pytest.approx(1.0)


@given(seed=st.integers(0, 2**31), size=st.sampled_from([0.0, 1.0]))
@settings(max_examples=30, deadline=None)
def test_the_scale_of_the_deviations_follows_the_robot(seed: int, size: float) -> None:
    """A robot that is its model has the smallest scale, one with all deviations of full size has the full one."""
    rng = np.random.default_rng(seed)
    p, n = 60, 400
    G, prior = rng.normal(size=(n, p)), np.geomspace(1e-3, 1e3, p)
    G = 5 * G / prior
    r = G @ (size * prior * np.clip(rng.normal(size=p), -2.9, 2.9)) + rng.normal(size=n)
    A, b, c = G.T @ G, G.T @ r, float(r @ r)
    _, scale = scaled(A, b, c, prior)
    assert scale == (1.0 if size else min(figures.SCALES))


@given(seed=st.integers(0, 2**31), size=st.floats(0, 10))
@settings(max_examples=50, deadline=None)
def test_a_scale_is_chosen_by_misfit_and_volume(seed: int, size: float) -> None:
    """No scale has less, each with its deviations inside their bounds."""
    rng = np.random.default_rng(seed)
    p, n = 6, 20
    G, prior = rng.normal(size=(n, p)), rng.uniform(0.5, 2, p)
    r = G @ (size * prior * rng.normal(size=p)) + rng.normal(size=n)
    A, b, c = G.T @ G, G.T @ r, float(r @ r)
    least, scale = scaled(A, b, c, prior)

    def cost(s: float) -> float:
        x = bounded(A, b, s * prior, figures.REASONABLE * s * prior)[0]
        volume = [0.5 * np.linalg.slogdet(np.eye(p) + t**2 * prior[:, None] * A * prior)[1] for t in (s, 1.0)]
        return misfit_at(A, b, c, x, s * prior) + volume[0] - volume[1]

    costs = {s: cost(s) for s in figures.SCALES}
    assert least == pytest.approx(min(costs.values()))
    assert costs[scale] == pytest.approx(least)
