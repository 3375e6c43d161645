"""Dense captures: few views are adjusted together, the others follow and are as good."""

from typing import Any

import numpy as np
import pytest
import rooms

from realsim import feedforward
from realsim.core.geometry import angle_deg, invert_T, make_T
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd import keyframes
from realsim.feedforward.rgbd.features import Evidence, build_tracks
from realsim.feedforward.rgbd.localize import Landmarks, localize

N = 16
TRUTH = rooms.path(N, step=0.02)


@pytest.fixture(scope="module")
def frames() -> list:
    return [rooms.frame(k, T, posed=True) for k, T in enumerate(TRUTH)]


@pytest.fixture(autouse=True)
def dense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyframes, "DENSE", 5)
    monkeypatch.setattr(keyframes, "SHIFT", 0.05)
    monkeypatch.setattr(keyframes, "TURN", np.radians(6))


def errors(found: Any, truth: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position (metres) and rotation (degrees) of every pose, worlds aligned at the first camera."""
    E = invert_T(invert_T(truth[0]) @ truth) @ (invert_T(found[0]) @ found)
    return np.linalg.norm(E[:, :3, 3], axis=1), np.array([angle_deg(e[:3, :3]) for e in E])


@pytest.mark.parametrize("poses", ["estimate", "given"])
def test_followers_are_placed_as_well_as_keyframes(frames: list, poses: str) -> None:
    found = feedforward.solve(rooms.frame_set(frames), PointsConfig(poses=poses))
    assert found.used == tuple(range(N))
    assert 2 <= found.statistics["keyframes"] < N / 2
    shift, turn = errors(found.T_world_camera, TRUTH)
    assert shift.max() < 0.006
    assert turn.max() < 0.15


def test_a_view_starts_a_centimetre_off_and_comes_back(frames: list) -> None:
    evidence = Evidence.of(frames[:9:2])
    tracks = build_tracks(evidence.views, evidence.matches([(0, 1), (1, 2), (2, 3), (3, 4)]))
    own = np.column_stack([tracks.xy, np.ones(len(tracks.z))]) * tracks.z[:, None]
    T = TRUTH[:9:2]
    world = np.einsum("mab,mb->ma", T[tracks.view, :3, :3], own) + T[tracks.view, :3, 3]
    points = np.stack([np.bincount(tracks.point, c, tracks.count) for c in world.T], 1)
    points /= np.bincount(tracks.point, minlength=tracks.count)[:, None]
    off = make_T(np.eye(3), [0.004, -0.004, 0.008])
    views = Evidence.of([frames[3]]).views
    found, residual = localize(views, (TRUTH[3] @ off)[None], Landmarks(evidence.views, T, tracks, points))
    assert np.linalg.norm((invert_T(TRUTH[3]) @ found[0])[:3, 3]) < 0.004
    assert 0 < residual[0] < 0.02


def test_without_features_all_views_are_keyframes(frames: list) -> None:
    views = Evidence.of([rooms.frame(k, T, color=False) for k, T in enumerate(TRUTH[:7])]).views
    assert keyframes.choose_by_poses(views, TRUTH[:7]) == (list(range(7)), {})
