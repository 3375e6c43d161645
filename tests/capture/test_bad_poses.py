"""Trajectories that are damaged, of another length, convention or time."""

from dataclasses import replace

import numpy as np
import pytest

from realsim.capture import inspect, read
from realsim.core.errors import PoseError, RealsimError

from .damage import cut, reason
from .scene import walk
from .test_layouts import CONFIG, frames_of
from .writers import (
    write_log,
    write_open3d,
    write_plain,
    write_sevenscenes,
    write_tum,
)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda T: T * np.nan, "NaN"),
        (lambda T: T @ np.diag([1.0, 1, -1, 1]), "reflection"),
        (lambda T: T @ np.diag([2.0, 2, 2, 1]), "scaled by 2"),
        (lambda T: T + np.array([[0, 0.3, 0, 0]] + [[0.0] * 4] * 3), "not rigid"),
        (lambda T: np.vstack([T[:3], [0, 0, 0.2, 1]]), "last row"),
        (lambda T: T[:3, :3], "wrong length"),
    ],
)
def test_one_bad_pose_costs_one_frame(damage, said, tmp_path):
    views = walk(8)
    write_sevenscenes(tmp_path, views)
    np.savetxt(tmp_path / "frame-000003.pose.txt", damage(views[3].T_world_camera))
    assert said in reason(frames_of(tmp_path), "frame-000003")


@pytest.mark.parametrize("damage", [lambda T: T * np.nan, lambda T: T @ np.diag([1.0, -1, 1, 1])])
def test_only_bad_poses_are_an_error_with_a_way_out(damage, tmp_path):
    views = walk(4)
    write_open3d(tmp_path, views)
    write_log(tmp_path / "trajectory.log", [damage(v.T_world_camera) for v in views])
    with pytest.raises(PoseError, match=r"--ignore-poses"):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize("count", [3, 9])
def test_a_trajectory_of_another_length(count, tmp_path):
    views = walk(10)
    write_open3d(tmp_path, views[:6])
    write_log(tmp_path / "trajectory.log", [v.T_world_camera for v in views[:count]], first=1)
    with pytest.raises(PoseError, match="another length") as caught:
        read(tmp_path, CONFIG)
    assert f"{count} poses" in str(caught.value)


def test_a_trajectory_that_is_cut_off(tmp_path):
    write_open3d(tmp_path, walk(4))
    cut(tmp_path / "trajectory.log", 0.9)
    with pytest.raises(PoseError):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize(
    ("convert", "said"),
    [(np.linalg.inv, "world to camera"), (lambda T: T @ np.diag([1.0, -1, -1, 1]), "OpenGL")],
)
def test_poses_of_another_convention_are_named(convert, said, tmp_path):
    views = walk(10)
    write_open3d(tmp_path, views)
    write_log(tmp_path / "trajectory.log", [convert(v.T_world_camera) for v in views])
    with pytest.raises(PoseError, match=said):
        read(tmp_path, CONFIG)


def test_timestamps_out_of_order_are_sorted_and_said(tmp_path):
    views = walk(8)
    write_tum(tmp_path, views)
    for name in ("rgb.txt", "groundtruth.txt"):
        lines = (tmp_path / name).read_text().splitlines()
        lines[3], lines[6] = lines[6], lines[3]
        (tmp_path / name).write_text("\n".join(lines))
    capture = frames_of(tmp_path)
    assert [f.timestamp for f in capture.frames] == pytest.approx([v.time for v in views])
    np.testing.assert_allclose(capture.frames[2].T_world_camera, views[2].T_world_camera, atol=1e-6)
    assert sum("out of order" in w for w in capture.warnings) == 2
    assert any("out of order" in w for w in inspect(tmp_path, CONFIG).wrong)


def test_repeated_timestamps_and_missing_partners(tmp_path):
    write_tum(tmp_path, walk(8))
    lines = (tmp_path / "rgb.txt").read_text().splitlines()
    (tmp_path / "rgb.txt").write_text("\n".join([*lines, lines[4]]))
    lines = (tmp_path / "depth.txt").read_text().splitlines()
    (tmp_path / "depth.txt").write_text("\n".join(lines[:3] + lines[4:]))
    capture = frames_of(tmp_path)
    assert any("repeated timestamps" in w for w in capture.warnings)
    assert len(capture) == 7
    assert "no depth image within 0.02 s" in capture.dropped[0].reason


def test_an_image_that_is_listed_but_not_there(tmp_path):
    write_tum(tmp_path, walk(6))
    path = sorted((tmp_path / "depth").iterdir())[2]
    path.unlink()
    capture = frames_of(tmp_path)
    assert len(capture) == 5
    assert "cannot be read" in capture.dropped[0].reason


@pytest.mark.parametrize(
    ("row", "error"),
    [("1700000000.1 0 0 0 0 0 0", "wrong length"), ("1700000000.1 0 0 zero 0 0 0 1", "not a number")],
)
def test_a_broken_row_of_a_trajectory(row, error, tmp_path):
    write_tum(tmp_path, walk(4))
    with (tmp_path / "groundtruth.txt").open("a") as file:
        file.write(row)
    with pytest.raises(RealsimError, match=error):
        read(tmp_path, CONFIG)


def test_rows_with_nan_are_left_out_and_said(tmp_path):
    write_tum(tmp_path, walk(6))
    text = (tmp_path / "groundtruth.txt").read_text().splitlines()
    stamp = text[3].split()[0]
    text[3] = f"{stamp} nan 0 0 0 0 0 1"
    (tmp_path / "groundtruth.txt").write_text("\n".join(text))
    capture = frames_of(tmp_path)
    assert len(capture) == 5
    assert any("1 rows with NaN" in w for w in capture.warnings)


def test_poses_of_another_time_altogether(tmp_path):
    write_tum(tmp_path, walk(4))
    (tmp_path / "groundtruth.txt").write_text("12.5 0 0 0 0 0 0 1\n12.6 0 0 0 0 0 0 1\n")
    with pytest.raises(PoseError, match="do not overlap"):
        read(tmp_path, CONFIG)


def test_a_pose_an_image_with_stamps_that_are_a_little_off(tmp_path):
    """Five a second, noted 3 ms after their images: too far apart to go between, and each has its image."""
    views = [replace(view, time=0.2 * k) for k, view in enumerate(walk(6))]
    write_tum(tmp_path, views)
    rows = [line.split() for line in (tmp_path / "groundtruth.txt").read_text().splitlines()[1:]]
    lines = (f"{float(stamp) + 0.003:.3f} {' '.join(pose)}" for stamp, *pose in rows)
    (tmp_path / "groundtruth.txt").write_text("\n".join(lines))
    capture = read(tmp_path, CONFIG)
    assert not capture.dropped
    for frame, view in zip(capture.frames, views, strict=True):
        np.testing.assert_allclose(frame.T_world_camera, view.T_world_camera, atol=1e-6)


def test_poses_between_the_images(tmp_path):
    write_tum(tmp_path, [replace(view, time=0.2 * k) for k, view in enumerate(walk(6))])
    lines = (tmp_path / "groundtruth.txt").read_text().splitlines()[1:]
    moved = (f"{float(stamp) + 0.1:.3f} {pose}" for stamp, pose in (line.split(maxsplit=1) for line in lines))
    (tmp_path / "groundtruth.txt").write_text("\n".join(moved))
    with pytest.raises(PoseError, match="too far apart"):
        read(tmp_path, CONFIG)


def test_positions_in_millimetres_are_asked_about(tmp_path):
    write_tum(tmp_path, walk(6))
    rows = np.loadtxt(tmp_path / "groundtruth.txt")
    rows[:, 1:4] *= 1000
    np.savetxt(tmp_path / "groundtruth.txt", rows, "%.9f")
    assert any("are the positions in metres?" in warning for warning in inspect(tmp_path, CONFIG).wrong)


def test_poses_that_a_layout_does_not_read_are_named(tmp_path):
    write_plain(tmp_path, walk(4))
    assert not any("poses" in warning for warning in frames_of(tmp_path).warnings)
    (tmp_path / "camera_poses.json").write_text("{}")
    assert any("camera_poses.json" in warning for warning in frames_of(tmp_path).warnings)
    assert not any("camera_poses" in warning for warning in read(tmp_path, replace(CONFIG, ignore_poses=True)).warnings)
