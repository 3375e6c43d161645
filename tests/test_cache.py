"""Finished stages come back as they were, and only while their inputs have not changed."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.cache import StageCache, pack, source_digest, unpack
from realsim.types import Dropped, Frame, FrameSet, Intrinsics, Solution


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
