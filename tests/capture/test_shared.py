"""The captures whose truth is known, and real ones whose conventions are."""

import json

import numpy as np
import pytest

from realsim.capture import CaptureConfig, inspect, read
from realsim.core.errors import CaptureError
from realsim.core.types import FrameSet

CONFIG = CaptureConfig()


@pytest.mark.parametrize(("name", "layout"), [("stake_a", "open3d"), ("narrow_a", "tum"), ("mixed_a", "sevenscenes")])
def test_rendered_captures_match_their_truth(name, layout, shared):
    folder = shared(f"captures/{name}")
    third = CaptureConfig(every=3)
    capture = read(folder / "capture", third)
    assert isinstance(capture, FrameSet)
    assert (capture.layout, len(capture), capture.dropped, capture.warnings) == (layout, 20, (), ())
    truth = json.loads((folder / "gt/gt.json").read_text())
    poses = json.loads((folder / "gt/gt_poses.json").read_text())
    for frame, pose in zip(capture.frames, poses[::3], strict=True):
        c = frame.intrinsics
        assert {k: getattr(c, k) for k in truth["intrinsics"]} == pytest.approx(truth["intrinsics"], abs=1e-3)
        difference = np.abs(frame.T_world_camera - np.array(pose["T_world_cam"]))
        assert difference.max() < (2e-3 if layout == "tum" else 1e-8)  # TUM's poses are samples at 100 Hz
        if frame.timestamp is not None:
            assert frame.timestamp == pytest.approx(pose["timestamp"], abs=1e-5)
    found = inspect(folder / "capture", CONFIG)
    assert found.wrong == ()
    assert found.poses["depth_agrees"] > 0.95
    assert 0.9 < found.depth["coverage"] < 1


def test_realsense_boxes(shared):
    capture = read(shared("real_captures/realsense_boxes_floor/data"), CONFIG)
    assert isinstance(capture, FrameSet)
    assert [f.name for f in capture.frames] == [f"{i:06d}" for i in range(10)], "the test images are no frames"
    c = capture.frames[0].intrinsics
    assert (c.fx, c.fy, c.cx, c.cy) == pytest.approx((617.25, 617.5486, 317.392, 245.980), abs=1e-3)
    assert not capture.has_poses
    assert capture.has_color
    assert 0.5 < np.median(capture.frames[0].depth()) < 3


def test_kinect_stairs(shared):
    capture = read(shared("real_captures/pcl_kinect_stairs/tutorials/pairwise"), CaptureConfig(every=4))
    assert isinstance(capture, FrameSet)
    assert len(capture) == 2  # of five, each of which takes a second to unpack
    c = capture.frames[0].intrinsics
    assert (c.width, c.height) == (640, 480)
    assert (c.fx, c.fy, c.cx, c.cy) == pytest.approx((525, 525, 319.5, 239.5), abs=1e-3)
    assert any("VIEWPOINT is 0 0 0 0 1 0 0" in a and "not applied" in a for a in capture.assumptions)
    assert not capture.has_poses
    assert not capture.has_color


def test_the_folder_above_names_the_capture(shared):
    folder = shared("real_captures/realsense_boxes_floor")
    with pytest.raises(CaptureError, match=r"did you mean .*realsense_boxes_floor/data"):
        read(folder, CONFIG)
