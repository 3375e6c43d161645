"""The learned matcher on pictures whose truth is known, and what poses from frames make of it."""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import rooms

from realsim import feedforward
from realsim.core.errors import ModelError
from realsim.core.geometry import angle_deg, invert_T
from realsim.core.types import Frame
from realsim.feedforward import matcher
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd import learned
from realsim.feedforward.rgbd.features import Match, build_tracks, prepare
from realsim.feedforward.rgbd.matching import make_edge

ESTIMATE = PointsConfig(poses="estimate")
TRUTH = rooms.path(4)
HOMOGRAPHY = np.array([[0.93, 0.08, 12.0], [-0.05, 0.97, 9.0], [1e-4, -5e-5, 1.0]])


def picture(width: int = 330, height: int = 250) -> np.ndarray:
    """(height, width, 3) overlapping shapes on texture; neither side is a multiple of the network's grid."""
    rng = np.random.default_rng(3)
    gray = cv2.resize((rooms.texture() * 150 + 50).astype(np.float32), (width, height))
    for _ in range(50):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        cv2.circle(gray, (x, y), int(rng.integers(4, 20)), float(rng.uniform(0, 255)), -1)
    return gray.astype(np.uint8)[..., None].repeat(3, -1)


def warped(image: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.warpPerspective(image, HOMOGRAPHY, (image.shape[1], image.shape[0])), np.uint8)


def off(a: matcher.Keypoints, b: matcher.Keypoints, matches: np.ndarray) -> np.ndarray:
    """(M,) pixels between matched keypoints by the homography."""
    p = np.column_stack([a.uv[matches[:, 0]], np.ones(len(matches))]) @ HOMOGRAPHY.T
    return np.linalg.norm(p[:, :2] / p[:, 2:] - b.uv[matches[:, 1]], axis=1)


@pytest.mark.parametrize("light", [1.0, 0.08])
def test_matches_of_a_warped_picture_agree_with_the_homography(light: float) -> None:
    image = picture()
    a, b = (matcher.extract((v * light).astype(np.uint8)) for v in (image, warped(image)))
    assert a.size == (330, 250)
    assert np.allclose(np.linalg.norm(a.descriptors, axis=1), 1, atol=1e-5)
    found = matcher.match(a, b)
    assert len(found) > 60
    assert len(np.unique(found[:, 0])) == len(np.unique(found[:, 1])) == len(found)
    distance = off(a, b, found)
    assert np.median(distance) < 1.5
    assert (distance < 4).mean() > 0.9


def test_another_picture_has_few_matches_and_a_rerun_the_same() -> None:
    a = matcher.extract(picture())
    other = matcher.extract(np.random.default_rng(0).integers(0, 255, (250, 330, 3)).astype(np.uint8))
    assert len(matcher.match(a, other)) < 0.05 * len(a.uv)
    again = matcher.extract(picture())
    assert again.uv.tobytes() == a.uv.tobytes()
    assert again.descriptors.tobytes() == a.descriptors.tobytes()


@pytest.mark.parametrize("image", [np.zeros((240, 320, 3), np.uint8), np.full((9, 14, 3), 90, np.uint8)])
def test_pictures_without_anything_have_no_matches(image: np.ndarray) -> None:
    nothing = matcher.extract(image)
    assert matcher.match(nothing, nothing).shape[1] == 2
    assert len(nothing.uv) < 5


def test_damaged_networks_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: None) -> None:
    (tmp_path / "broken.onnx").write_bytes(b"not a network")
    monkeypatch.setattr(matcher, "FILES", (tmp_path / "broken.onnx", tmp_path / "broken.onnx"))
    with pytest.raises(ModelError, match="learned matcher"):
        matcher.extract(picture())


def test_what_ships_says_where_it_is_from() -> None:
    for name in ("NOTICE", "LICENSE"):
        assert "Apache License" in (matcher.FOLDER / name).read_text()
    assert sum(f.stat().st_size for f in matcher.FILES) < 4e6
    for file in matcher.FILES:  # the exporter writes its sources' paths into the graph unless they are taken out
        assert not re.search(rb"[\w/]+\.py\b", file.read_bytes())


# ---------------------------------------------------------------- poses


@pytest.fixture
def fresh() -> Iterator[None]:
    """Sessions opened in the test are its own."""
    matcher._sessions.cache_clear()
    yield
    matcher._sessions.cache_clear()


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return [rooms.frame(k, T) for k, T in enumerate(TRUTH)]


@pytest.fixture(scope="module")
def dark(frames: list[Frame]) -> list[Frame]:
    """The same with so little light that classical features find nothing."""
    return [replace(f, read_color=partial(_dimmed, f.read_color)) for f in frames]


def _dimmed(read) -> np.ndarray:  # type: ignore[no-untyped-def]
    return (read() * 0.03).astype(np.uint8)


def test_frames_that_features_hold_together_are_not_shown(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("asked without need")

    monkeypatch.setattr(matcher, "extract", refuse)
    found = feedforward.solve(rooms.frame_set(frames), ESTIMATE)
    bare = feedforward.solve(rooms.frame_set(frames), replace(ESTIMATE, learned_matches=False))
    assert found.T_world_camera.tobytes() == bare.T_world_camera.tobytes()
    assert found.statistics == bare.statistics
    assert found.warnings == bare.warnings


def test_dark_frames_are_placed_and_it_is_said(dark: list[Frame]) -> None:
    assert all(len(v.z) < 12 for v in prepare(dark))
    found = feedforward.solve(rooms.frame_set(dark), ESTIMATE)
    assert found.used == tuple(range(len(dark)))
    assert found.statistics["learned_pairs"] >= len(dark) - 1
    assert not found.statistics.get("by_shape")
    assert any("a learned matcher joined" in w for w in found.warnings)
    E = invert_T(invert_T(TRUTH[0]) @ TRUTH) @ found.T_world_camera
    assert np.linalg.norm(E[:, :3, 3], axis=1).max() < 0.03
    assert max(angle_deg(e[:3, :3]) for e in E) < 1


def test_what_it_adds_belongs_to_tracks_and_weighs_less(dark: list[Frame]) -> None:
    views = prepare(dark)
    found = learned.join_pieces(views, [], seed=0)
    assert found.queried >= len(found.matches) > 0
    for m in found.matches:
        for k, features in ((m.i, m.a), (m.j, m.b)):
            assert features.min() >= len(views[k].z)
            assert features.max() < len(found.views[k].z)
    tracks = build_tracks(found.views, found.matches)
    assert tracks.count > 50
    assert np.allclose(tracks.focal, views[0].focal / learned.NOISE)


def test_without_its_package_it_is_said(dark: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matcher, "find_spec", lambda name: None)
    found = learned.join_pieces(prepare(dark), [], seed=0)
    assert not found.matches
    assert any('pip install "realsim[matching]"' in line for line in found.notes())


def test_two_pieces_are_not_joined_by_one_link() -> None:
    def link(i: int, j: int) -> Match:
        return Match(i, j, np.arange(30), np.arange(30), np.eye(4))

    def kept(*links: tuple[int, int]) -> list[tuple[int, int]]:
        edges = [make_edge(link(*pair)) for pair in ((0, 1), (1, 2), (3, 4), (6, 7))]
        return [(m.i, m.j) for m in learned.keep_supported([link(*pair) for pair in links], 8, edges)]

    assert kept((2, 3)) == []
    assert kept((2, 3), (2, 4)) == []
    assert kept((1, 3), (2, 4)) == [(1, 3), (2, 4)]
    assert kept((2, 3), (4, 5)) == [(4, 5)]
    # What is joined is one piece: 3 and 6 then say together where 0 to 2 are.
    assert kept((1, 6), (2, 3)) == []
    assert kept((1, 6), (2, 3), (3, 6), (4, 7)) == [(1, 6), (2, 3), (3, 6), (4, 7)]
    assert kept((4, 6), (5, 7)) == [(5, 7)]
