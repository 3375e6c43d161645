"""Captures that are wrong as a whole: none may end in a scene without a word."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from realsim import capture, feedforward
from realsim.capture.config import CaptureConfig
from realsim.core.errors import PoseError
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.rgbd import hypotheses
from realsim.feedforward.rgbd.hypotheses import Hypothesis
from realsim.synth import SynthConfig, write_capture

FRAMES = 10


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A capture with poses, and another of another place."""
    folder = tmp_path_factory.mktemp("two")
    made = [
        write_capture(folder / name, SynthConfig(name, poses=True, frames=FRAMES, width=320, seed=seed)).capture
        for name, seed in (("mixed", 1), ("stakes", 2))
    ]
    return made[0], made[1]


def spoilt(two: tuple[Path, Path], to: Path, change: Callable[[Path, Path], None]) -> Path:
    shutil.copytree(two[0], to)
    change(to, two[1])
    return to


def poses_times(factor: float) -> Callable[[Path, Path], None]:
    def change(folder: Path, _: Path) -> None:
        path = folder / "trajectory.log"
        rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
        for k, row in enumerate(rows):
            if 1 <= k % 5 <= 3:  # of four rows of a matrix, those with a position
                row[3] = repr(factor * float(row[3]))
        path.write_text("\n".join(" ".join(row) for row in rows) + "\n")

    return change


def poses_of_another(folder: Path, other: Path) -> None:
    shutil.copy(other / "trajectory.log", folder / "trajectory.log")


def colour_of_another(folder: Path, other: Path) -> None:
    for mine, theirs in zip(*(sorted((f / "color").iterdir()) for f in (folder, other)), strict=True):
        shutil.copy(theirs, mine)


def three_of_another(folder: Path, other: Path) -> None:
    half_of_another(folder, other, FRAMES - 3)


def half_of_another(folder: Path, other: Path, first: int = FRAMES // 2) -> None:
    for kind in ("color", "depth"):
        pairs = list(zip(*(sorted((f / kind).iterdir()) for f in (folder, other)), strict=True))
        for mine, theirs in pairs[first:]:
            shutil.copy(theirs, mine)


def three_later(kind: str) -> Callable[[Path, Path], None]:
    def change(folder: Path, _: Path) -> None:
        files = sorted((folder / kind).iterdir())
        images = [f.read_bytes() for f in files]
        for k, file in enumerate(files):
            file.write_bytes(images[min(k + 3, len(files) - 1)])

    return change


def mirrored(kind: str, axis: int = 1) -> Callable[[Path, Path], None]:
    def change(folder: Path, _: Path) -> None:
        for file in (folder / kind).iterdir():
            image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(file), np.flip(image, axis))

    return change


def solved(folder: Path, poses: Any = "given") -> tuple[Any, Any]:
    frames: Any = capture.read(folder, CaptureConfig(keep_blurred=True))
    return frames, feedforward.solve(frames, PointsConfig(poses=poses))


def test_the_same_capture_unspoilt_is_used_whole_and_without_a_word(two: tuple[Path, Path]) -> None:
    frames, found = solved(two[0])
    assert len(found.used) == FRAMES
    assert frames.warnings == ()
    assert found.warnings == ()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (poses_times(100), "centimetres|100 units a metre"),
        (poses_times(1.1), "1.1"),
        (poses_of_another, "contradict"),
        (colour_of_another, "colour images belong to other depth"),
    ],
)
def test_what_is_wrong_as_a_whole_is_refused_with_its_name(
    two: tuple[Path, Path], tmp_path: Path, change: Callable[[Path, Path], None], word: str
) -> None:
    folder = spoilt(two, tmp_path / "wrong", change)
    with pytest.raises(PoseError, match=word):
        solved(folder)


def test_poses_that_depth_agrees_with_are_of_no_other_convention(
    two: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # as on a shared capture with the colour of another: 60 cm by features, 6 cm half a frame later, 0.6 cm by depth
    offset = Hypothesis("a time offset of -0.5 frames", lambda T: T, lambda *_: 0.064, "associate anew")
    monkeypatch.setattr(hypotheses, "of_poses", lambda scale: [offset])
    folder = spoilt(two, tmp_path / "wrong", colour_of_another)
    with pytest.raises(PoseError, match="colour images belong to other depth"):
        solved(folder)


@pytest.mark.parametrize(
    ("change", "word", "poses"),
    [
        (three_later("color"), "3 frames late", "given"),
        (mirrored("depth"), "mirrored left to right", "given"),
        (mirrored("color", 0), "mirrored top to bottom", "estimate"),
    ],
)
def test_colour_and_depth_that_do_not_belong_together_are_refused_with_or_without_poses(
    two: tuple[Path, Path], tmp_path: Path, change: Callable[[Path, Path], None], word: str, poses: str
) -> None:
    folder = spoilt(two, tmp_path / "wrong", change)
    with pytest.raises(PoseError, match=word):
        solved(folder, poses)


def test_half_the_frames_of_another_room_are_named(two: tuple[Path, Path], tmp_path: Path) -> None:
    folder = spoilt(two, tmp_path / "half", half_of_another)
    with pytest.raises(PoseError, match="more than one place") as caught:
        solved(folder)
    assert f"000000 to {FRAMES // 2 - 1:06d} ({FRAMES // 2} frames) agree with each other" in str(caught.value)


def test_frames_of_another_room_take_none_of_this_one_with_them(two: tuple[Path, Path], tmp_path: Path) -> None:
    folder = spoilt(two, tmp_path / "some", three_of_another)
    _, found = solved(folder)
    assert found.used[: FRAMES - 3] == tuple(range(FRAMES - 3))
    assert len(found.dropped) >= 2  # the third sees little but floor, which fits every floor


def test_exact_poses_past_equal_doors_are_used_whole(tmp_path: Path) -> None:
    """Of frames so far apart, most matches take one door for the next."""
    made = write_capture(tmp_path / "doors", SynthConfig("corridor", 20, True, width=320, seed=1, once=True))
    frames, found = solved(made.capture)
    assert len(found.used) == len(frames)
    assert found.warnings == ()


@pytest.mark.slow
def test_half_the_frames_of_another_room_are_not_mixed_in(two: tuple[Path, Path], tmp_path: Path) -> None:
    """Three frames of each: every pair of two places is looked at with the learned matcher too."""
    folder, each = spoilt(two, tmp_path / "half", half_of_another), 3
    for kind in ("color", "depth"):
        files = sorted((folder / kind).iterdir())
        for file in (*files[: FRAMES // 2 - each], *files[FRAMES // 2 + each :]):
            file.unlink()
    (folder / "trajectory.log").unlink()
    _, found = solved(folder, "estimate")
    mine = np.array(found.used) < each
    assert mine.all() or not mine.any()
    assert len(found.dropped) >= each - 1
    assert any("pieces" in w for w in found.warnings)
