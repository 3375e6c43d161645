"""Depth that was recorded as its own sensor saw it, and depth in another unit."""

import shutil
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest

from realsim.capture import CaptureConfig, inspect, read
from realsim.capture.alignment import misalignment
from realsim.capture.consistency import check_agreement
from realsim.capture.units import check_height
from realsim.core.errors import CaptureError
from realsim.core.types import Frame, FrameSet

from .test_layouts import CONFIG

CASE = "cases/scenes/r10_realsense_not_aligned"


def test_a_realsense_without_align_is_put_right(shared):
    found = inspect(shared(CASE), CONFIG)
    assert any("not aligned to the colour" in line and "rs.align" in line for line in found.wrong)
    capture = read(shared(CASE), CONFIG)
    assert isinstance(capture, FrameSet)
    color = capture.frames[0].color_intrinsics
    assert color is not None
    assert color.fx == pytest.approx(615, rel=0.07)


def test_with_the_colour_cameras_intrinsics_it_is_refused_with_the_depths_focal_length(shared, tmp_path):
    shutil.copytree(shared(CASE), tmp_path / "capture", copy_function=shutil.copyfile)
    (tmp_path / "capture").chmod(0o755)
    (tmp_path / "capture/intrinsics.txt").unlink()
    (tmp_path / "capture/intrinsics.txt").write_text("615 615 320 240 640 480")
    with pytest.raises(CaptureError, match="not aligned") as caught:
        read(tmp_path / "capture", CONFIG)
    assert caught.value.hint is not None
    assert float(caught.value.hint.split("about ")[1].split()[0]) == pytest.approx(385, rel=0.07)


@dataclass(frozen=True)
class Cropped:
    """The middle of a colour image, enlarged: a colour camera of a narrower view."""

    frame: Frame
    share: float

    def __call__(self) -> np.ndarray:
        import cv2

        color = self.frame.color()
        assert color is not None
        height, width = color.shape[:2]
        w, h = round(width * self.share), round(height * self.share)
        x, y = (width - w) // 2, (height - h) // 2
        return cv2.resize(color[y : y + h, x : x + w], (width, height), interpolation=cv2.INTER_AREA)


def test_a_narrower_colour_camera_is_found(shared):
    capture, share = read(shared("captures/narrow_a/capture"), CaptureConfig(max_frames=12)), 0.8
    assert isinstance(capture, FrameSet)
    assert misalignment(capture.frames) is None
    found = misalignment([replace(f, read_color=Cropped(f, share)) for f in capture.frames])
    assert found is not None
    assert found.zoom == pytest.approx(share, rel=0.05)


def test_distances_along_the_rays_are_named(shared):
    capture = read(shared("captures/narrow_a/capture"), CaptureConfig(max_frames=14))
    assert isinstance(capture, FrameSet)
    assert check_agreement(capture)[1] is None
    lengths = np.linalg.norm(capture.frames[0].intrinsics.rays(), axis=-1).astype(np.float32)
    frames = [replace(f, read_depth=partial(np.multiply, f.depth(), lengths)) for f in capture.frames]
    with pytest.raises(CaptureError, match="the distance from the camera"):
        check_agreement(replace(capture, frames=tuple(frames)))


@pytest.mark.parametrize("seed", [0, 3, 4, 7])
def test_ground_with_edges_everywhere_tells_nothing(seed, shared):
    capture = read(shared("captures/narrow_a/capture"), CaptureConfig(max_frames=6))
    assert isinstance(capture, FrameSet)
    frame = capture.frames[3]
    fine = np.random.default_rng(seed).integers(0, 256, (80, 106, 3)).astype(np.uint8)
    gravel = fine.repeat(6, axis=0).repeat(6, axis=1)
    assert misalignment([replace(frame, read_color=lambda: gravel)] * 4) is None


@dataclass(frozen=True)
class Longer:
    """Depth whose steps are taken for longer ones than they are."""

    frame: Frame
    factor: float

    def __call__(self) -> np.ndarray:
        return self.frame.depth() * np.float32(self.factor)

    def step(self) -> float:
        return 0.001


@pytest.mark.parametrize("name", ["captures/stake_a/capture", "real_captures/scannerapp_chair/data"])
def test_a_camera_that_hangs_too_high_tells_the_unit(name, shared):
    capture = read(shared(name), CaptureConfig(max_frames=6))
    assert isinstance(capture, FrameSet)
    assert check_height([replace(f, read_depth=Longer(f, 1.0)) for f in capture.frames]) is None
    said = check_height([replace(f, read_depth=Longer(f, 4.0)) for f in capture.frames])
    assert said is not None
    assert "0.00025" in said
