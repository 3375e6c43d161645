"""Refinement of given poses and recovery of the depth gain, on a small textured room with known truth."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from realsim.core.errors import PoseError
from realsim.core.geometry import angle_deg, exp_so3, invert_T, make_T, transform
from realsim.core.types import Frame, Intrinsics
from realsim.feedforward.rgbd.bias import grouped_error
from realsim.feedforward.rgbd.check_poses import check_poses, measure_scale
from realsim.feedforward.rgbd.depth_colour_sync import check_together
from realsim.feedforward.rgbd.features import Evidence, build_tracks, rigid_ransac
from realsim.feedforward.rgbd.hypotheses import BODY, FLIP, MIRROR, shift_poses
from realsim.feedforward.rgbd.refine import RefineResult, refine
from realsim.feedforward.rgbd.refine_adjust import initial_state
from realsim.synth.camera import look_at

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
NOISE = 0.0015
N = 14


def boxes() -> NDArray[np.float64]:
    """(B, 2, 3) axis-aligned boxes on the floor z = 0."""
    low = np.array([[-0.5, 0.3, 0], [0.4, -0.5, 0], [1.2, 0.4, 0], [-0.6, -0.8, 0], [0.5, 0.9, 0]])
    size = np.array([[0.5, 0.4, 0.35], [0.4, 0.4, 0.2], [0.5, 0.5, 0.45], [0.3, 0.3, 0.25], [0.3, 0.3, 0.5]])
    return np.stack([low, low + size], 1)


def cast(origin: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance along rays (M, 3) to the floor and the boxes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(rays[:, 2] < 0, -origin[2] / rays[:, 2], np.inf)
        for low, high in boxes():
            a, b = (low - origin) / rays, (high - origin) / rays
            enter, leave = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
            t = np.where((enter < leave) & (enter > 0) & (enter < t), enter, t)
    return t


def texture(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M,) grey of a solid texture: random values on lattices of several sizes, trilinear."""
    grey = np.zeros(len(points))
    for k, (size, strength) in enumerate(((0.16, 1.0), (0.07, 1.0), (0.03, 0.8))):
        lattice = np.random.default_rng(k).normal(size=(64, 64, 64))
        q = points / size + 7.3
        base = np.floor(q).astype(int)
        part = q - base
        part = part * part * (3 - 2 * part)
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, part, 1 - part), axis=1)
            grey += strength * weight * lattice[tuple(((base + corner) % 64).T)]
    return grey


@functools.cache
def truth() -> tuple[NDArray[np.float64], list[NDArray[np.float64]], list[NDArray[np.uint8]]]:
    """Poses (N, 4, 4) on an arc around the boxes, and per frame exact depth and colour."""
    rays = CAMERA.rays().reshape(-1, 3).astype(float)
    T, depths, colors = [], [], []
    for k in range(N):
        a = -1.9 + 1.0 * k / (N - 1)
        eye = np.array([0.3 + 1.8 * np.cos(a), 0.2 + 1.8 * np.sin(a), 1.1 + 0.25 * np.sin(2.1 * k)])
        pose = look_at(eye, np.array([0.3, 0.1, 0.1]), 0.1 * np.sin(1.7 * k))
        world = rays @ pose[:3, :3].T
        t = cast(eye, world)
        grey = np.where(np.isfinite(t), 128 + 40 * texture(eye + np.where(np.isfinite(t), t, 0)[:, None] * world), 0)
        T.append(pose)
        depths.append(np.where(t < 6, t, 0).reshape(240, 320))
        colors.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8).reshape(240, 320, 1), 3, 2))
    return np.stack(T), depths, colors


def frames_of(bias: float = 1.0, color: bool = True, seed: int = 3) -> list[Frame]:
    """What a sensor with that depth bias and stereo noise saw."""
    _, depths, colors = truth()
    rng = np.random.default_rng(seed)
    out = []
    for k in range(N):
        d = (bias * (depths[k] + NOISE * depths[k] ** 2 * rng.normal(size=depths[k].shape))).astype(np.float32)
        read_color = (lambda c=colors[k]: c) if color else None
        out.append(Frame(f"{k:06d}", CAMERA, lambda d=d: d, read_color))
    return out


@functools.cache
def evidence_of(bias: float = 1.0, color: bool = True) -> tuple[list[Frame], Evidence]:
    frames = frames_of(bias, color)
    return frames, Evidence.of(frames)


def perturbed(meters: float, degrees: float, seed: int = 1) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    T = truth()[0].copy()
    for pose in T:
        pose[:3, 3] += rng.normal(size=3) * meters
        pose[:3, :3] = exp_so3(rng.normal(size=3) * np.radians(degrees)) @ pose[:3, :3]
    return T


@functools.cache
def refined(bias: float, meters: float, degrees: float) -> RefineResult:
    """Poses that are off by so much, refined with the gain."""
    frames, evidence = evidence_of(bias)
    return refine(frames, perturbed(meters, degrees), estimate_gain=True, trust="metric", evidence=evidence)


def position_error(T: NDArray[np.float64]) -> float:
    return float(np.sqrt((np.linalg.norm(T[:, :3, 3] - truth()[0][:, :3, 3], axis=1) ** 2).mean()))


@pytest.mark.parametrize(("bias", "meters", "degrees"), [(1.009, 0, 0), (0.99, 0.002, 0.1), (1.009, 0.01, 0.5)])
def test_an_injected_gain_is_recovered_and_poses_get_better(bias: float, meters: float, degrees: float) -> None:
    T, found = perturbed(meters, degrees), refined(bias, meters, degrees)
    assert found.depth_gain_sigma < 0.006
    assert abs(found.depth_gain - 1 / bias) < 3 * found.depth_gain_sigma + 3e-4
    assert position_error(found.T_world_camera) < max(0.6 * position_error(T), 0.0015)
    # White noise shrinks by the 5x5 fit; a single pixel's figure would be too large here, a noise-free one too small.
    assert NOISE / 6 < found.statistics["sigma_z_over_z2"] < NOISE / 2
    assert found.residual_m < 0.02


def test_how_much_poses_are_believed_is_found_from_the_data() -> None:
    exact, noisy = refined(1.009, 0, 0), refined(1.009, 0.01, 0.5)
    assert exact.statistics["given_position_sigma_m"] < 0.001
    assert 0.005 < noisy.statistics["given_position_sigma_m"] < 0.02
    assert exact.depth_gain_sigma < noisy.depth_gain_sigma


def test_same_input_same_output() -> None:
    frames, _ = evidence_of(1.009)
    first = refined(1.009, 0.01, 0.5)
    again = refine(frames, perturbed(0.01, 0.5), estimate_gain=True, trust="metric", evidence=Evidence.of(frames))
    assert first.depth_gain == again.depth_gain
    assert np.array_equal(first.T_world_camera, again.T_world_camera)


def test_without_colour_surfaces_alone_improve_the_poses() -> None:
    frames, evidence = evidence_of(1.0, color=False)
    T = perturbed(0.01, 0.5)
    found = refine(frames, T, estimate_gain=True, trust="metric", evidence=evidence)
    assert position_error(found.T_world_camera) < 0.8 * position_error(T)
    assert abs(found.depth_gain - 1) < 3 * max(found.depth_gain_sigma, 1e-3)
    assert any("without colour" in w for w in found.warnings)


def test_estimated_poses_keep_the_scale_of_the_depth() -> None:
    frames, evidence = evidence_of(1.009)
    T = perturbed(0.005, 0.3)
    found = refine(frames, T, estimate_gain=False, trust="estimated", evidence=evidence)
    assert found.depth_gain == 1.0
    assert not np.isfinite(found.depth_gain_sigma)
    a, b = found.T_world_camera[:, :3, 3], truth()[0][:, :3, 3]
    ratio = np.linalg.norm(a[-1] - a[0]) / np.linalg.norm(b[-1] - b[0])
    assert ratio == pytest.approx(1.009, abs=0.004)
    with pytest.raises(PoseError, match="gain"):
        refine(frames, T, estimate_gain=True, trust="estimated", evidence=evidence)


@pytest.mark.parametrize("n", [1, 4])
def test_without_baseline_the_gain_is_not_invented(n: int) -> None:
    frames = frames_of(1.02)[:1] * n
    T = np.repeat(truth()[0][:1], n, axis=0)
    found = refine(frames, T, estimate_gain=True, trust="metric")
    assert found.depth_gain == 1.0
    assert found.depth_gain_sigma > 0.01
    assert any("cannot be determined" in w for w in found.warnings)


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.diag([1.0, 1, -1, 1])])
def test_poses_that_are_not_rigid_are_refused_by_name(bad: NDArray[np.float64]) -> None:
    frames, evidence = evidence_of()
    T = truth()[0].copy()
    T[5] = bad
    with pytest.raises(PoseError, match="000005"):
        refine(frames, T, estimate_gain=False, trust="metric", evidence=evidence)


# ---------------------------------------------------------------- check


@pytest.mark.parametrize(("bias", "color"), [(1.009, True), (1.0, False)])
@pytest.mark.parametrize(("meters", "degrees"), [(0, 0), (0.01, 0.5)])
def test_usable_poses_pass(bias: float, color: bool, meters: float, degrees: float) -> None:
    frames, evidence = evidence_of(bias, color)
    check = check_poses(frames, perturbed(meters, degrees), evidence=evidence)
    assert check.contradicting == ()
    assert check.kept(frames) == list(range(N))


@pytest.mark.parametrize("wrong", [[4], [2, 3, 9]])
def test_frames_with_wrong_poses_are_named_and_no_others(wrong: list[int]) -> None:
    frames, evidence = evidence_of()
    T = truth()[0].copy()
    for k in wrong:
        T[k, :3, 3] += [0.1 * (k % 3), 0.15, 0.1]
        T[k, :3, :3] = exp_so3([0.05 * k, 0.1, 0]) @ T[k, :3, :3]
    check = check_poses(frames, T, evidence=evidence)
    assert [d.name for d in check.contradicting] == [frames[k].name for k in wrong]
    assert all("contradicts" in d.reason for d in check.contradicting)
    rest = evidence.subset(check.kept(frames))
    assert len(rest.views) == N - len(wrong)


@pytest.mark.parametrize(
    ("word", "break_it"),
    [
        ("OpenGL camera axes", lambda T: T @ FLIP),
        ("world-to-camera", invert_T),
        ("body axes", lambda T: T @ invert_T(BODY)),
        ("scale", lambda T: np.stack([make_T(p[:3, :3], 1.3 * p[:3, 3]) for p in T])),
        ("time offset", lambda T: shift_poses(T, 3)),
        ("mirrored images", lambda T: MIRROR @ T @ MIRROR),
    ],
)
def test_a_wrong_convention_is_refused_by_name(word, break_it) -> None:  # type: ignore[no-untyped-def]
    frames, evidence = evidence_of()
    with pytest.raises(PoseError, match=word):
        check_poses(frames, break_it(truth()[0]), evidence=evidence)


def test_frames_that_nothing_joins_are_said() -> None:
    frames, evidence = evidence_of()
    T = truth()[0].copy()
    T[N // 2 :, :3, 3] += [0, 0, 30.0]
    check = check_poses(frames, T, evidence=evidence)
    assert any(
        f"joins {frames[0].name} to {frames[N // 2 - 1].name} ({N // 2} frames) and" in w for w in check.warnings
    )


def test_colour_of_another_time_is_said_or_refused() -> None:
    frames, _ = evidence_of()
    late = [replace(f, read_color=frames[max(k - 1, 0)].read_color) for k, f in enumerate(frames)]
    try:
        warnings = check_poses(late, truth()[0], evidence=Evidence.of(late, 0)).warnings
    except PoseError as error:
        warnings = (error.message,)
    assert any("colour" in w for w in warnings)


@pytest.mark.parametrize(("frames_late", "said"), [(3, "3 frames late"), (-2, "2 frames early")])
def test_depth_of_another_time_is_refused(frames_late: int, said: str) -> None:
    frames, _ = evidence_of()
    sources = [frames[min(max(k - frames_late, 0), N - 1)] for k in range(N)]
    moved = [replace(f, read_depth=s.read_depth) for f, s in zip(frames, sources, strict=True)]
    with pytest.raises(PoseError, match=said):
        check_together(Evidence.of(moved, 0).views, None)


@pytest.mark.parametrize("units", [0.2, 7.3])
def test_poses_up_to_scale_get_it_from_the_depth(units: float) -> None:
    _, evidence = evidence_of()
    T = truth()[0].copy()
    T[:, :3, 3] *= units
    factor, error = measure_scale(evidence, T)
    assert factor * units == pytest.approx(1, abs=max(3 * error, 0.01))
    assert error < 0.01


def test_poses_up_to_scale_without_features_are_refused() -> None:
    _, evidence = evidence_of(1.0, color=False)
    with pytest.raises(PoseError, match="scale of the given poses"):
        measure_scale(evidence, truth()[0])


def test_millimetres_are_recognised_without_colour() -> None:
    frames, evidence = evidence_of(1.0, color=False)
    T = truth()[0].copy()
    T[:, :3, 3] *= 1000
    with pytest.raises(PoseError, match="millimetres"):
        check_poses(frames, T, evidence=evidence)


# ---------------------------------------------------------------- parts


def test_rigid_ransac_finds_the_motion_among_outliers() -> None:
    rng = np.random.default_rng(0)
    Q = rng.uniform([-1, -1, 1], [1, 1, 2], (60, 3))
    T = make_T(exp_so3([0.1, -0.2, 0.05]), [0.3, 0.1, -0.1])
    P = transform(T, Q)
    P[40:] += rng.uniform(0.2, 1, (20, 3))
    found = rigid_ransac(P, Q, rng)
    assert found is not None
    assert np.allclose(found[0], T, atol=1e-9)
    assert found[1].tolist() == [True] * 40 + [False] * 20


def test_matches_agree_with_the_truth_and_tracks_meet_a_view_once() -> None:
    _, evidence = evidence_of()
    matches = evidence.matches([(i, i + 1) for i in range(N - 1)] + [(i, i + 2) for i in range(N - 2)])
    T = truth()[0]
    assert len(matches) > N
    for m in matches:
        off = invert_T(m.T_i_j) @ invert_T(T[m.i]) @ T[m.j]
        assert np.linalg.norm(off[:3, 3]) < 0.03
        assert angle_deg(off[:3, :3]) < 1.5
    tracks = build_tracks(evidence.views, matches)
    assert np.all(np.diff(tracks.point) >= 0)
    assert len(np.unique(np.stack([tracks.view, tracks.point]), axis=1).T) == len(tracks.z)
    assert initial_state(T, tracks).X.shape == (tracks.count, 3)


def test_grouped_error_of_independent_influences_is_their_norm() -> None:
    x = np.random.default_rng(0).normal(size=20000)
    assert grouped_error(x, np.arange(len(x))) == pytest.approx(np.linalg.norm(x), rel=0.01)
    assert grouped_error(np.repeat(x, 4), np.repeat(np.arange(len(x)), 4)) == pytest.approx(
        4 * np.linalg.norm(x), rel=0.01
    )
