"""Recording through the library's interface: nothing lost, nothing half, everything readable."""

import json
import sys

import numpy as np
import pytest

from realsim.capture import CaptureConfig, read
from realsim.capture.record import RecordConfig, record
from realsim.cli.command_line import main
from realsim.core.errors import CaptureError, MissingExtraError
from realsim.core.types import FrameSet

from .scene import CAMERA, walk

LIVE = RecordConfig(frames=6, warm_up=2)


def test_a_recording_is_a_plain_capture(tmp_path, realsense):
    views = walk(10)
    realsense.plugged_in[:] = views
    made = record(tmp_path / "out", RecordConfig(frames=6, warm_up=2, serial="0123"))
    assert (made.frames, made.lost, made.interrupted) == (6, 0, False)
    assert made.seconds == pytest.approx(0.5)
    assert "D435 0123" in made.device
    assert realsense.calls == [
        "device 0123",
        "stream.depth 640x480 format.z16 30",
        "stream.color 640x480 format.rgb8 30",
    ]
    capture = read(tmp_path / "out", CaptureConfig())
    assert isinstance(capture, FrameSet)
    assert (capture.layout, len(capture), capture.dropped) == ("plain", 6, ())
    for frame, view in zip(capture.frames, views[2:8], strict=True):
        np.testing.assert_array_equal(frame.color(), view.color)
        np.testing.assert_allclose(frame.depth(), view.depth, atol=0.0005 + 1e-6)
        assert (frame.intrinsics.fx, frame.intrinsics.cy) == (CAMERA.fx, CAMERA.cy)


def test_an_interrupt_keeps_what_was_recorded(tmp_path, realsense):
    realsense.plugged_in[:] = walk(10)
    realsense.interrupts_after[:] = [5]
    made = record(tmp_path / "out", RecordConfig(warm_up=0))
    assert made.interrupted
    assert made.frames == 5
    capture = read(tmp_path / "out", CaptureConfig())
    assert isinstance(capture, FrameSet)
    assert len(capture) == 5
    assert not list((tmp_path / "out").rglob(".*")), "no temporary files are left"


def test_a_camera_that_is_unplugged_keeps_what_was_recorded(tmp_path, realsense):
    realsense.plugged_in[:] = walk(10)
    realsense.breaks_after[:] = [4]
    with pytest.raises(CaptureError, match="stopped early") as caught:
        record(tmp_path / "out", RecordConfig(warm_up=0))
    assert "4 frames up to there are kept" in str(caught.value.hint)
    assert len(list((tmp_path / "out/depth").iterdir())) == 4


def test_limits_of_time_and_every_nth_frame(tmp_path, realsense):
    realsense.plugged_in[:] = walk(10)
    made = record(tmp_path / "out", RecordConfig(seconds=0.95, every=3, warm_up=0))
    assert (made.frames, made.lost) == (4, 0)
    assert made.seconds == pytest.approx(0.9)


def test_no_camera(tmp_path):
    with pytest.raises(CaptureError, match="does not start") as caught:
        record(tmp_path / "out", LIVE)
    assert "No device connected" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_the_library_is_an_extra(tmp_path, monkeypatch, realsense):
    realsense.write_bag(tmp_path / "a.bag", walk(2))
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(MissingExtraError, match=r"\[realsense\]"):
        record(tmp_path / "out", LIVE)
    with pytest.raises(MissingExtraError, match=r"\[realsense\]"):
        read(tmp_path / "a.bag", CaptureConfig())


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path, realsense):
    realsense.plugged_in[:] = walk(2)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(CaptureError, match="not empty"):
        record(tmp_path, LIVE)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_bag_is_unpacked_once_and_again_when_it_changes(tmp_path, realsense):
    views = walk(6)
    realsense.write_bag(tmp_path / "a.bag", views[:4])
    first = read(tmp_path / "a.bag", CaptureConfig())
    opened = len(realsense.calls)
    assert realsense.calls == ["real time False"]
    assert isinstance(first, FrameSet)
    assert read(tmp_path / "a.bag", CaptureConfig()) == first
    assert len(realsense.calls) == opened
    realsense.write_bag(tmp_path / "a.bag", views)
    again = read(tmp_path / "a.bag", CaptureConfig())
    assert isinstance(again, FrameSet)
    assert (len(first), len(again)) == (4, 6)


def test_the_depth_unit_is_the_cameras(tmp_path, realsense):
    views = walk(3)
    realsense.write_bag(tmp_path / "a.bag", views, unit=0.0001)
    capture = read(tmp_path / "a.bag", CaptureConfig())
    assert isinstance(capture, FrameSet)
    np.testing.assert_allclose(capture.frames[1].depth(), views[1].depth, atol=6e-5)
    assert any("0.0001" in a for a in capture.assumptions)


def test_blue_and_red_are_not_exchanged(tmp_path, realsense, monkeypatch):
    views = walk(3)
    realsense.write_bag(tmp_path / "a.bag", views)
    monkeypatch.setattr(realsense, "color_format", [realsense.format.bgr8])
    capture = read(tmp_path / "a.bag", CaptureConfig())
    assert isinstance(capture, FrameSet)
    np.testing.assert_array_equal(capture.frames[1].color(), views[1].color[..., ::-1])


def test_a_bag_of_something_else_leaves_nothing_behind(tmp_path):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(CaptureError, match=r"not a (readable ROS bag|recording)"):
        read(tmp_path / "a.bag", CaptureConfig())
    import os

    assert not [p for p in os.scandir(os.environ["REALSIM_CACHE"]) if any(os.scandir(p.path))]


def test_the_command(tmp_path, realsense, capsys):
    realsense.plugged_in[:] = walk(10)
    assert main(["record", str(tmp_path / "out"), "--frames", "3", "--warm-up", "0", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["frames"] == 3
    assert len(list((tmp_path / "out/rgb").iterdir())) == 3
