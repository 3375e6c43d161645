"""Poses from frames alone, on a ray-cast room whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
import rooms

from realsim import capture, feedforward
from realsim.capture.config import CaptureConfig
from realsim.core.errors import CaptureError, PoseError, UnknownNameError
from realsim.core.geometry import angle_deg, invert_T, make_T
from realsim.core.types import Solution
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd.features import prepare
from realsim.feedforward.rgbd.matching import match_by_features, match_guided
from realsim.feedforward.rgbd.overlap import overlap, register

TRUTH = rooms.path(7)
ESTIMATE = PointsConfig(poses="estimate")


@pytest.fixture(scope="module")
def frames() -> list:
    return [rooms.frame(k, T) for k, T in enumerate(TRUTH)]


@pytest.fixture(scope="module")
def solution(frames: list) -> Solution:
    return feedforward.solve(rooms.frame_set(frames), ESTIMATE)


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Largest error of position (metres) and rotation (degrees), worlds aligned at the first camera."""
    E = invert_T(invert_T(truth[0]) @ truth) @ (invert_T(found[0]) @ found)
    return float(np.linalg.norm(E[:, :3, 3], axis=1).max()), max(angle_deg(e[:3, :3]) for e in E)


def test_poses_are_found(solution: Solution) -> None:
    assert solution.used == tuple(range(7))
    assert np.array_equal(solution.T_world_camera[0], np.eye(4))
    assert not solution.world_is_capture
    assert solution.depth_gain == 1
    shift, turn = errors(solution.T_world_camera, TRUTH)
    assert shift < 0.006
    assert turn < 0.15


def test_twice_the_same_bytes(frames: list) -> None:
    one, two = (feedforward.solve(rooms.frame_set(frames[:3]), ESTIMATE) for _ in range(2))
    assert one.T_world_camera.tobytes() == two.T_world_camera.tobytes()
    assert one.statistics == two.statistics


def test_a_pair_far_apart(frames: list) -> None:
    views = prepare(frames)
    found = match_by_features(views, 0, 5, 0)
    assert found is not None
    E = invert_T(invert_T(TRUTH[0]) @ TRUTH[5]) @ found[0].T_i_j
    assert np.linalg.norm(E[:3, 3]) < 0.03
    assert found[1].agreement > 0.95


def test_guided_matching_finds_the_same_points(frames: list) -> None:
    views = prepare(frames[:3])
    T = invert_T(TRUTH[0]) @ TRUTH[2]
    found = match_guided(views, 0, 2, T)
    assert found is not None
    off = views[0].points[found.a] - (views[2].points[found.b] @ T[:3, :3].T + T[:3, 3])
    assert len(found.a) > 40
    assert np.median(np.linalg.norm(off, axis=1)) < 0.01


def test_depth_contradicts_a_wrong_motion(frames: list) -> None:
    A, B = prepare(frames[:2])
    right = invert_T(TRUTH[0]) @ TRUTH[1]
    assert overlap(A, B, right).agreement > 0.95
    assert overlap(A, B, right @ make_T(None, [0, 0, 0.4])).agreement < 0.6


def test_surfaces_pull_a_pair_together(frames: list) -> None:
    A, B = prepare([frames[2], frames[3]])
    right = invert_T(TRUTH[2]) @ TRUTH[3]
    T, _, rms = register(A, B, right @ make_T(None, [0.03, -0.02, 0.03]))
    assert np.linalg.norm((invert_T(right) @ T)[:3, 3]) < 0.01
    assert rms < 0.01


def test_frames_of_another_room_are_dropped_and_named(frames: list) -> None:
    away = make_T(None, [0.0, -3.0, -4.0])  # high above, where other surfaces with another pattern are seen
    other = replace(rooms.frame(90, away @ TRUTH[0], offset=3.7), name="elsewhere")
    found = feedforward.solve(rooms.frame_set([*frames[:3], other]), ESTIMATE)
    assert found.used == (0, 1, 2)
    assert [d.name for d in found.dropped] == ["elsewhere"]
    assert "does not fit" in found.dropped[0].reason


def test_no_two_frames_fit() -> None:
    blank = [
        replace(f, read_color=None, read_depth=lambda: np.zeros((240, 320), np.float32))
        for f in (rooms.frame(0, TRUTH[0]), rooms.frame(1, TRUTH[1]))
    ]
    with pytest.raises(PoseError, match="cannot be connected"):
        feedforward.solve(rooms.frame_set(blank), ESTIMATE)


def test_without_colour_shapes_are_registered() -> None:
    plain = [rooms.frame(k, T, color=False) for k, T in enumerate(TRUTH[1:4])]
    found = feedforward.solve(rooms.frame_set(plain), ESTIMATE)
    assert found.used == (0, 1, 2)
    shift, turn = errors(found.T_world_camera, TRUTH[1:4])
    assert shift < 0.02
    assert turn < 0.6


def test_given_poses_stay_in_their_world() -> None:
    posed = [rooms.frame(k, T, posed=True) for k, T in enumerate(TRUTH[:4])]
    found = feedforward.solve(rooms.frame_set(posed), PointsConfig())
    assert found.world_is_capture
    assert found.used == tuple(range(4))
    assert np.abs(found.T_world_camera - TRUTH[:4]).max() < 0.01


def test_one_frame_is_its_own_world(frames: list) -> None:
    found = feedforward.solve(rooms.frame_set(frames[:1]), ESTIMATE)
    assert found.used == (0,)
    assert np.array_equal(found.T_world_camera, np.eye(4)[None])


def test_what_is_asked_for_must_be_there(frames: list) -> None:
    with pytest.raises(PoseError, match="no poses"):
        feedforward.solve(rooms.frame_set(frames), PointsConfig(poses="given"))
    with pytest.raises(CaptureError, match="no frames"):
        feedforward.solve(rooms.frame_set([]), PointsConfig())
    with pytest.raises(UnknownNameError, match="rgbdd"):
        feedforward.solve(rooms.frame_set(frames), PointsConfig(backend="rgbdd"))


@pytest.mark.slow
def test_a_rendered_capture_without_its_poses(shared) -> None:  # type: ignore[no-untyped-def]
    """Every third frame of a part of a hand-held capture: absolute trajectory error after a similarity, and scale."""
    whole = capture.read(shared("captures/stake_a/capture"), CaptureConfig())
    some = replace(whole, frames=whole.frames[:24:3])
    truth = np.stack([f.T_world_camera for f in some.frames])
    found = feedforward.solve(some, ESTIMATE)
    assert found.used == tuple(range(len(truth)))
    A, B = found.T_world_camera[:, :3, 3], truth[:, :3, 3]
    a, b = A - A.mean(0), B - B.mean(0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    scale = (S * np.diag(D)).sum() / (a**2).sum()
    assert np.sqrt(((scale * a @ (U @ D @ Vt).T - b) ** 2).sum(1).mean()) < 0.006
    assert abs(scale - 1) < 0.012
