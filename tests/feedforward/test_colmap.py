"""The RGB-only baseline on the ray-cast room: poses up to scale, points on the surfaces that they were seen on."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import rooms

from realsim import feedforward
from realsim.core.errors import CaptureError, MissingExtraError
from realsim.feedforward.config import PointsConfig

COLMAP = PointsConfig(backend="colmap")


@pytest.fixture(scope="module")
def frames() -> list:
    return [rooms.frame(k, T) for k, T in enumerate(rooms.path(5))]


def test_poses_and_points_up_to_one_scale(frames: list) -> None:
    pytest.importorskip("pycolmap")
    frame_set = rooms.frame_set(frames)
    solution = feedforward.solve(frame_set, COLMAP)
    assert solution.used == tuple(range(5))
    truth = rooms.path(5)
    a, b = (T[:, :3, 3] - T[:1, :3, 3] for T in (solution.T_world_camera, truth))
    scale = np.linalg.norm(b[-1]) / np.linalg.norm(a[-1])
    assert np.allclose(scale * a @ truth[0, :3, :3].T, b, atol=0.01)
    maps = feedforward.pointmaps(frame_set, solution, COLMAP)
    for k, frame in enumerate(frames):
        view = maps.load(k)
        assert view.mask.sum() > 30
        ratio = frame.depth()[view.mask] / view.points[view.mask][:, 2]
        assert abs(np.median(ratio) / scale - 1) < 0.01


def test_needs_colour_and_the_package(frames: list, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as m:
        m.setitem(sys.modules, "pycolmap", None)
        with pytest.raises(MissingExtraError, match="pycolmap"):
            feedforward.solve(rooms.frame_set(frames), COLMAP)
    pytest.importorskip("pycolmap")
    with pytest.raises(CaptureError, match="colour"):
        feedforward.solve(rooms.frame_set([replace(f, read_color=None) for f in frames]), COLMAP)
