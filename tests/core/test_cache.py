"""Finished stages come back as they were, and only while their inputs have not changed."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.capture.finishing import InRange
from realsim.capture.images import ConfidenceImage, DepthImage
from realsim.capture.video import VideoFrame
from realsim.core import cache
from realsim.core.cache import StageCache, code_digest, pack, source_digest, unpack
from realsim.core.types import Dropped, Frame, FrameSet, Intrinsics, Solution


def solution() -> Solution:
    return Solution(
        used=(0, 2),
        T_world_camera=np.stack([np.eye(4)] * 2),
        world_is_capture=True,
        depth_gain=0.99,
        dropped=(Dropped("b", "blurred"),),
        statistics={"pairs": [1, 2], "note": None},
        arrays={"depth": np.arange(6, dtype=np.float32).reshape(2, 3)},
    )


def test_round_trip_keeps_types_shapes_and_values() -> None:
    back = unpack(pack(solution()))
    assert isinstance(back, Solution)
    assert back.used == (0, 2)
    assert back.dropped == (Dropped("b", "blurred"),)
    assert back.statistics == {"pairs": [1, 2], "note": None}
    assert back.arrays["depth"].dtype == np.float32
    np.testing.assert_array_equal(back.arrays["depth"], solution().arrays["depth"])


def test_only_our_own_types_are_made_again() -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        pack({"x": object()})
    tree = np.frombuffer(b'{"type": "ModuleType", "fields": {}}', np.uint8)
    store = io.BytesIO()
    np.savez(store, tree=tree)
    with pytest.raises(ValueError, match="unknown type"):
        unpack(store.getvalue())


def test_kept_results_are_reused_and_broken_ones_made_again(tmp_path: Path) -> None:
    store, calls = StageCache(tmp_path), []

    def make() -> Solution:
        calls.append(1)
        return solution()

    assert store.get_or_make("k", make)[1] is False
    assert store.get_or_make("k", make)[1] is True
    (tmp_path / "k.npz").write_bytes(b"cut off")
    assert store.get_or_make("k", make)[1] is False
    assert len(calls) == 2
    assert StageCache(None).get_or_make("k", make)[1] is False


def test_an_entry_with_damaged_content_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The archive's directory is whole; what it lists cannot be unpacked, is no JSON, or fits no type."""
    said: list[str] = []
    monkeypatch.setattr(cache, "note", said.append)
    store, path = StageCache(tmp_path), tmp_path / "k.npz"
    store.get_or_make("k", solution)
    assert said == [], "what was never kept is no damage"
    good = path.read_bytes()
    start = good.index(b"tree.npy") + len(b"tree.npy")
    path.write_bytes(good[:start] + bytes(b ^ 0xFF for b in good[start : start + 200]) + good[start + 200 :])
    assert store.get_or_make("k", solution)[1] is False
    assert store.get_or_make("k", solution)[1] is True
    nested = np.frombuffer(b"[" * 100_000, np.uint8)
    np.savez(path, tree=nested)
    assert store.get_or_make("k", solution)[1] is False
    fields = np.frombuffer(b'{"type": "Dropped", "fields": {"nobody": 1}}', np.uint8)
    np.savez(path, tree=fields)
    assert store.get_or_make("k", solution)[1] is False
    assert len(said) == 3
    assert all(str(path) in text for text in said)


def test_the_digest_sees_files_poses_and_intrinsics(tmp_path: Path) -> None:
    image = tmp_path / "depth.png"
    image.write_bytes(b"1")
    frame = Frame("a", Intrinsics(4, 3, 5.0, 5.0, 1.5, 1.0), lambda: np.zeros((3, 4), np.float32), files=(image,))
    frames = FrameSet((frame,), tmp_path, "plain")
    first = source_digest(frames)
    assert source_digest(frames) == first
    assert source_digest(replace(frames, frames=(frame.with_pose(np.eye(4)),))) != first
    other = replace(frame, intrinsics=Intrinsics(4, 3, 5.1, 5.0, 1.5, 1.0))
    assert source_digest(replace(frames, frames=(other,))) != first
    image.write_bytes(b"2")
    assert source_digest(frames) != first


def test_the_digest_sees_how_files_are_read(tmp_path: Path) -> None:
    """The depth's unit may come from a file that is no frame's own, such as intrinsics.json."""

    def captured(folder: Path, unit: float = 0.001, sure: bytes = b"1", best: int = 2) -> FrameSet:
        folder.mkdir(exist_ok=True)
        image, confidence = folder / "depth.png", folder / "confidence.png"
        image.write_bytes(b"1")
        confidence.write_bytes(sure)
        camera, depth = Intrinsics(4, 3, 5.0, 5.0, 1.5, 1.0), InRange(DepthImage(image, unit), 0.15, 6.0)
        reader = ConfidenceImage(confidence, best)
        return FrameSet((Frame("a", camera, depth, read_confidence=reader, files=(image,)),), folder, "plain")

    first = source_digest(captured(tmp_path / "a"))
    assert source_digest(captured(tmp_path / "b")) == first  # the same capture elsewhere
    assert source_digest(captured(tmp_path / "a", unit=0.0002)) != first
    assert source_digest(captured(tmp_path / "a", sure=b"2")) != first
    assert source_digest(captured(tmp_path / "a", best=255)) != first


def test_a_video_that_all_frames_share_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video = tmp_path / "rgb.mp4"
    video.write_bytes(b"1")
    camera, seen = Intrinsics(4, 3, 5.0, 5.0, 1.5, 1.0), []

    def depth() -> np.ndarray:
        return np.zeros((3, 4), np.float32)

    shared = tuple(Frame(f"f{i}", camera, depth, VideoFrame(video, i), files=(video,) * (i == 0)) for i in range(3))
    monkeypatch.setattr(cache, "digest", lambda *parts: seen.extend(parts))
    source_digest(FrameSet(shared, tmp_path, "stray"))
    assert seen.count(video) == 1


def test_another_version_of_a_package_is_other_code(monkeypatch: pytest.MonkeyPatch) -> None:
    first = code_digest("scale")
    monkeypatch.setattr(cache, "version", lambda name: "0.0.0")
    code_digest.cache_clear()
    assert code_digest("scale") != first
    code_digest.cache_clear()
