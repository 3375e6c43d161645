"""Every layout gives back what was written, by its own conventions."""

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from realsim.capture import LAYOUTS, CaptureConfig, inspect, read
from realsim.capture.layout import Recognition
from realsim.capture.recognition import recognise
from realsim.core.errors import CaptureError, PoseError, RealsimError, UnknownNameError
from realsim.core.geometry import R_to_quat, is_rotation, transform
from realsim.core.types import FrameSet, Intrinsics

from .scene import CAMERA, walk
from .writers import (
    LOSSY,
    WITHOUT_POSES,
    WRITERS,
    camera_points,
    column_major,
    write_bop,
    write_folders,
    write_open3d,
    write_pcd,
    write_plain,
    write_rtabmap,
    write_scannet,
    write_sevenscenes,
    write_tum,
)

CONFIG = CaptureConfig()


def frames_of(folder, config=CONFIG) -> FrameSet:
    capture = read(folder, config)
    assert isinstance(capture, FrameSet)
    return capture


@pytest.fixture(scope="module", params=WRITERS)
def written(request, tmp_path_factory):
    """(layout, folder of a capture, what was written)."""
    folder, views = tmp_path_factory.mktemp("written"), walk()
    WRITERS[request.param](folder, views)
    return request.param, folder, views


def test_round_trip(written):
    name, folder, views = written
    capture = frames_of(folder)
    assert capture.layout == name
    assert len(capture) == len(views)
    assert capture.dropped == ()
    assert capture.has_poses == (name not in WITHOUT_POSES)
    assert len({f.name for f in capture.frames}) == len(views)
    quantum = 0.0005 if name != "tum" else 0.0001
    for frame, view in zip(capture.frames, views, strict=True):
        c = frame.intrinsics
        np.testing.assert_allclose([c.fx, c.fy, c.cx, c.cy], [88, 87, 46.5, 37], atol=1e-3)
        assert (c.width, c.height) == (CAMERA.width, CAMERA.height)
        depth, color = frame.depth(), frame.color()
        assert depth.dtype == np.float32
        np.testing.assert_allclose(depth, view.depth, atol=quantum + 1e-6)
        assert color is not None
        assert color.dtype == np.uint8
        small = cv2.resize(color, (c.width, c.height), interpolation=cv2.INTER_NEAREST)
        assert np.abs(small.astype(float) - view.color).mean() <= LOSSY.get(name, 0)
        if frame.read_confidence is not None:
            assert frame.read_confidence()[view.depth > 0].min() == 1
        if frame.T_world_camera is not None:
            np.testing.assert_allclose(frame.T_world_camera, view.T_world_camera, atol=1e-6)
            assert is_rotation(frame.T_world_camera[:3, :3])
    again = frames_of(folder)
    assert again.assumptions == capture.assumptions
    assert [f.name for f in again.frames] == [f.name for f in capture.frames]
    packed = pickle.dumps(capture)  # frames hold no images, and can be sent to another process
    assert len(packed) < 2500 * len(capture)
    np.testing.assert_array_equal(pickle.loads(packed).frames[0].depth(), capture.frames[0].depth())


def test_inspection_says_what_and_why(written):
    name, folder, views = written
    layout, why = recognise(folder, "auto", LAYOUTS)  # by itself alone
    assert (layout.name, why.complete) == (name, True)
    found = inspect(folder, CONFIG)
    assert found.layout == name
    assert found.evidence
    assert found.frames["used"] == len(views)
    share = np.mean([(v.depth > 0).mean() for v in views])
    assert found.depth["coverage"] == pytest.approx(share, abs=0.001)
    json.dumps(found.as_dict())
    text = found.render()
    for assumption in found.assumptions:
        assert assumption in text
    if found.poses["given"]:
        assert found.poses["path_m"] == pytest.approx(9 * np.linalg.norm([0.08, 0.01, 0.03]), abs=1e-3)
        assert found.poses["depth_agrees"] > 0.95


def test_inspecting_twice_says_the_same(tmp_path):
    write_open3d(tmp_path, walk())
    assert inspect(tmp_path, CONFIG).as_dict() == inspect(tmp_path, CONFIG).as_dict()


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_keeps_its_contract(name, tmp_path):
    layout = LAYOUTS[name]
    assert layout.name == name
    assert layout.looks_for
    (tmp_path / "notes.md").write_text("nothing to see")
    for path in (tmp_path, tmp_path / "notes.md"):
        seen = layout.recognise(path)
        assert isinstance(seen, Recognition)
        assert not seen.complete


def test_unknown_layout_lists_what_each_one_looks_for(tmp_path):
    (tmp_path / "holiday.mp4").write_bytes(b"x")
    with pytest.raises(CaptureError) as caught:
        read(tmp_path, CONFIG)
    for name in LAYOUTS:
        assert f"{name}: {LAYOUTS[name].looks_for}" in str(caught.value)
    assert "holiday.mp4" in str(caught.value)


def test_unknown_layout_name_suggests_the_closest(tmp_path):
    write_plain(tmp_path, walk(2))
    with pytest.raises(UnknownNameError, match="did you mean open3d"):
        read(tmp_path, CaptureConfig(layout="open3"))


def test_the_folder_above_a_capture_names_the_capture(tmp_path):
    write_plain(tmp_path / "data", walk(2))
    (tmp_path / "LICENSE").write_text("x")
    with pytest.raises(CaptureError, match=r"did you mean .*data"):
        read(tmp_path, CONFIG)


def test_two_layouts_in_one_folder_are_ambiguous(tmp_path):
    write_tum(tmp_path, walk(4))
    write_sevenscenes(tmp_path, walk(4))
    with pytest.raises(CaptureError, match="several layouts") as caught:
        read(tmp_path, CONFIG)
    assert "--layout tum" in str(caught.value)
    assert frames_of(tmp_path, CaptureConfig(layout="sevenscenes")).layout == "sevenscenes"


def test_open3d_reads_what_realsense_scripts_leave(tmp_path):
    write_folders(tmp_path, walk(4), "color")
    (tmp_path / "cam_params_realsense.json").write_text(json.dumps(column_major()))
    write_folders(tmp_path / "extra", walk(1))
    (tmp_path / "extra/color/000000.png").rename(tmp_path / "test_img_color.png")
    capture = frames_of(tmp_path)
    assert capture.layout == "open3d"
    assert len(capture) == 4
    assert not capture.has_poses
    assert "column by column" in " ".join(capture.assumptions)


def test_open3d_trajectory_beside_a_plain_camera_is_not_overlooked(tmp_path):
    write_open3d(tmp_path, walk(4))
    (tmp_path / "camera_intrinsic.json").rename(tmp_path / "intrinsics.json")
    capture = frames_of(tmp_path)
    assert capture.layout == "open3d"
    assert capture.has_poses


def test_open3d_headers_with_gaps_name_their_frames(tmp_path):
    views = walk(8)
    write_open3d(tmp_path, views)
    lines = (tmp_path / "trajectory.log").read_text().splitlines()
    # Frames 2 and 5 were not tracked: their poses are missing, the headers of the others still say whose they are.
    kept = [line for at in range(0, len(lines), 5) if at // 5 not in (2, 5) for line in lines[at : at + 5]]
    (tmp_path / "trajectory.log").write_text("\n".join(kept))
    capture = frames_of(tmp_path)
    assert [f.name for f in capture.frames] == [f"{i:06d}" for i in (0, 1, 3, 4, 6, 7)]
    np.testing.assert_allclose(capture.frames[2].T_world_camera, views[3].T_world_camera, atol=1e-9)
    assert {d.name for d in capture.dropped} == {"000002", "000005"}


def test_tum_uses_the_pose_at_the_colour_images_time(tmp_path):
    views = walk(8)
    write_tum(tmp_path, views, depth_delay=-0.015)
    lines = (tmp_path / "groundtruth.txt").read_text().splitlines()
    # Poses half a period away from the images: only interpolation can give those of the images.
    shifted = [lines[0]]
    for line in lines[1:]:
        stamp, rest = line.split(" ", 1)
        shifted.append(f"{float(stamp) + 0.05:.6f} {rest}")
    (tmp_path / "groundtruth.txt").write_text("\n".join(shifted))
    capture = frames_of(tmp_path, CaptureConfig(max_pose_gap=0.11))
    assert len(capture) == 7, "the first image is before the first pose"
    for k, frame in enumerate(capture.frames):
        middle = (views[k].T_world_camera[:3, 3] + views[k + 1].T_world_camera[:3, 3]) / 2
        np.testing.assert_allclose(frame.T_world_camera[:3, 3], middle, atol=1e-6)
    assert "no pose" in capture.dropped[0].reason


def test_tum_takes_camera_and_depth_unit_from_the_settings_of_orb_slam(tmp_path):
    views = walk(2)
    write_tum(tmp_path, views)
    (tmp_path / "calibration.txt").unlink()
    (tmp_path / "TUM3.yaml").write_text(ORB_SLAM.format("Camera", "", 5000))
    capture = frames_of(tmp_path)
    assert capture.frames[0].intrinsics.fx == 88
    assert any("TUM3.yaml" in a and "0.0002" in a for a in capture.assumptions)
    np.testing.assert_allclose(capture.frames[0].depth(), views[0].depth, atol=2e-4)


@pytest.mark.parametrize("by", ["node", "time"])
@pytest.mark.parametrize("of", ["poses", "camera_poses"])
def test_rtabmap_puts_the_camera_on_the_robot_where_poses_are_the_robots(by, of, tmp_path):
    views = walk(4)
    write_rtabmap(tmp_path, views, by, of)
    rows = (tmp_path / f"map_{of}.txt").read_text().splitlines()
    (tmp_path / f"map_{of}.txt").write_text("\n".join([rows[0], *rows[:1:-1]]))  # another order, one pose less
    frames = {f.name: f for f in frames_of(tmp_path).frames}
    assert len(frames) == 3
    for i, view in enumerate(views[1:], 1):
        name = f"{3 * i + 1}" if by == "node" else f"{view.time:.6f}"
        np.testing.assert_allclose(frames[name].T_world_camera, view.T_world_camera, atol=1e-6)


def test_rtabmap_matrices_without_a_name_need_as_many_images(tmp_path):
    views = walk(3)
    write_rtabmap(tmp_path, views, of="camera_poses")
    table = np.array([v.T_world_camera[:3].ravel() for v in views])
    np.savetxt(tmp_path / "map_camera_poses.txt", table)
    np.testing.assert_allclose(frames_of(tmp_path).frames[2].T_world_camera, views[2].T_world_camera, atol=1e-6)
    np.savetxt(tmp_path / "map_camera_poses.txt", table[1:])
    with pytest.raises(PoseError, match="nothing tells which pose"):
        frames_of(tmp_path)


@pytest.mark.parametrize(
    ("file", "old", "new", "error"),
    [
        ("map_calib/*.yaml", "-1., 0., 0.2", "0.2", "local_transform"),
        ("map_calib/*.yaml", "local_transform", "elsewhere", "where the camera is on the robot"),
        ("map_calib/*.yaml", "projection_matrix", "p", "not a camera matrix"),
    ],
)
def test_rtabmap_names_what_is_wrong_with_its_files(file, old, new, error, tmp_path):
    write_rtabmap(tmp_path, walk(2))
    for path in tmp_path.glob(file):
        path.write_text(path.read_text().replace(old, new))
    with pytest.raises(RealsimError, match=error):
        frames_of(tmp_path)


def test_rtabmap_leaves_out_the_images_of_nodes_that_were_lost(tmp_path):
    write_rtabmap(tmp_path, walk(2))
    rows = (tmp_path / "map_poses.txt").read_text().splitlines()
    (tmp_path / "map_poses.txt").write_text("\n".join([rows[0], "nan " * 8 + "1", rows[2]]))
    assert [f.name for f in frames_of(tmp_path).frames] == ["4"]


def test_bop_names_what_is_wrong_with_its_cameras(tmp_path):
    write_bop(tmp_path, walk(2))
    path = tmp_path / "scene_camera.json"
    good = json.loads(path.read_text())
    for key, value, error in (
        ("depth_scale", 0.1, "not one depth scale"),
        ("cam_K", [1, 2], "nine finite numbers"),
        ("cam_t_w2c", None, "nine and translation of three"),
    ):
        path.write_text(json.dumps({**good, "1": {**good["1"], key: value}}))
        try:
            said = " ".join(d.reason for d in frames_of(tmp_path).dropped)
        except RealsimError as raised:
            said = str(raised)
        assert error in said


def test_sevenscenes_needs_intrinsics_and_offers_the_datasets_own(tmp_path):
    write_sevenscenes(tmp_path, walk(3))
    (tmp_path / "camera-intrinsics.txt").unlink()
    with pytest.raises(CaptureError, match="no intrinsics"):
        read(tmp_path, CONFIG)
    with pytest.raises(CaptureError, match="585 585 320 240 640 480"):
        read(tmp_path, CaptureConfig(layout="sevenscenes"))


def test_sevenscenes_mends_rotations_and_says_so(tmp_path):
    views = walk(5)
    write_sevenscenes(tmp_path, views)
    T = views[2].T_world_camera.copy()
    T[:3, :3] *= 1.004
    np.savetxt(tmp_path / "frame-000002.pose.txt", T)
    capture = frames_of(tmp_path)
    np.testing.assert_allclose(capture.frames[2].T_world_camera, views[2].T_world_camera, atol=1e-6)
    assert any("1 of 5 rotations are slightly off SO(3)" in a for a in capture.assumptions)


def test_scannet_keeps_two_cameras_and_drops_untracked_frames(tmp_path):
    write_scannet(tmp_path, walk(6))
    np.savetxt(tmp_path / "pose/3.txt", np.full((4, 4), -np.inf))
    capture = frames_of(tmp_path)
    assert [f.name for f in capture.frames] == ["0", "1", "2", "4", "5"]
    assert "infinity" in capture.dropped[0].reason
    of_color = capture.frames[0].color_intrinsics
    assert of_color is not None
    assert (of_color.width, of_color.fx) == (2 * CAMERA.width, 2 * CAMERA.fx)


@pytest.mark.parametrize("data", ["ascii", "binary"])
@pytest.mark.parametrize("kind", ["rgb F 4", "rgb U 4", "rgba U 4"])
def test_pcd_colour_and_padding_as_pcl_writes_them(kind, data, tmp_path):
    """PCL's own PointXYZRGB has four bytes after xyz and twelve after rgb, and its rgb is a float."""
    name, letter, _ = kind.split()
    view = walk(1)[0]
    points, rgb = camera_points(view).reshape(-1, 3), view.color.reshape(-1, 3).astype(np.uint32)
    packed = rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]
    header = (
        f"VERSION .7\nFIELDS x y z _ {name} _\nSIZE 4 4 4 1 4 1\nTYPE F F F U {letter} U\nCOUNT 1 1 1 4 1 12\n"
        f"WIDTH {CAMERA.width}\nHEIGHT {CAMERA.height}\nPOINTS {len(points)}\nDATA {data}\n"
    )
    if data == "binary":
        table = np.zeros(len(points), [("p", "<f4", 3), ("_", "u1", 4), ("c", "<u4"), ("__", "u1", 12)])
        table["p"], table["c"] = points, packed
        body = table.tobytes()
    else:
        shown = [repr(float(v)) for v in packed.view(np.float32)] if letter == "F" else [str(v) for v in packed]
        rows = [f"{x} {y} {z} 0 0 0 0 {c} {'0 ' * 12}" for (x, y, z), c in zip(points, shown, strict=True)]
        body = "\n".join(rows).encode()
    (tmp_path / "a.pcd").write_bytes(header.encode() + body)
    frame = frames_of(tmp_path).frames[0]
    np.testing.assert_allclose(frame.depth(), view.depth, atol=1e-6)
    np.testing.assert_array_equal(frame.color(), view.color)


OPENGL = np.diag([1.0, -1, -1])
BODY = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


@pytest.mark.parametrize(
    ("stored", "viewpoint", "said"),
    [
        (np.eye(3), "0 0 0 0 1 0 0", "not applied"),
        (OPENGL, "0 0 0 1 0 0 0", "OpenGL"),
        (BODY, "0 0 0 1 0 0 0", "ROS body"),
    ],
)
@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_pcd_axes_and_viewpoint_traps(stored, viewpoint, said, data, tmp_path):
    views = walk(3)
    for i, view in enumerate(views):
        write_pcd(tmp_path / f"{i}.pcd", camera_points(view) @ stored.T, None, viewpoint, data)
    capture = frames_of(tmp_path)
    assert not capture.has_poses
    assert not capture.has_color
    assert said in " ".join(capture.assumptions)
    for frame, view in zip(capture.frames, views, strict=True):
        np.testing.assert_allclose(frame.depth(), view.depth, atol=1e-5)


@pytest.mark.parametrize("in_world", [False, True])
def test_pcd_viewpoints_that_differ_are_poses(in_world, tmp_path):
    views = walk(6)
    for i, view in enumerate(views):
        T = view.T_world_camera
        text = " ".join(f"{v:.9f}" for v in (*T[:3, 3], *R_to_quat(T[:3, :3])))
        points = camera_points(view)
        write_pcd(tmp_path / f"{i}.pcd", transform(T, points) if in_world else points, view.color, text)
    capture = frames_of(tmp_path)
    assert capture.has_poses
    assert any("VIEWPOINT differs" in a for a in capture.assumptions)
    for frame, view in zip(capture.frames, views, strict=True):
        np.testing.assert_allclose(frame.T_world_camera, view.T_world_camera, atol=1e-6)
        np.testing.assert_allclose(frame.depth(), view.depth, atol=1e-4)


def test_pcd_reads_open3d_compressed_clouds(tmp_path):
    import open3d as o3d

    view = walk(1)[0]
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(camera_points(view).reshape(-1, 3).astype(np.float32)))
    o3d.t.io.write_point_cloud(str(tmp_path / "a.pcd"), cloud, compressed=True)
    # Open3D writes one long row; the grid is what makes it a depth image.
    data = (tmp_path / "a.pcd").read_bytes()
    count = CAMERA.width * CAMERA.height
    data = data.replace(b"WIDTH %d\nHEIGHT 1\n" % count, b"WIDTH %d\nHEIGHT %d\n" % (CAMERA.width, CAMERA.height))
    (tmp_path / "a.pcd").write_bytes(data)
    assert b"DATA binary_compressed" in data
    np.testing.assert_allclose(frames_of(tmp_path).frames[0].depth(), view.depth, atol=1e-6)


ORB_SLAM = """%YAML:1.0
#------
Camera.type: "PinHole"
{0}.fx: 88.0
{0}.fy: 87.0
{0}.cx: 46.5
{0}.cy: 37.0
{0}.k1: 0.0
Camera.width: 96
Camera.height: 72
{1}DepthMapFactor: {2}.0
"""
ROWS = "88., 0., 46.5, 0., 87., 37., 0., 0., 1."


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("intrinsics.txt", "88 87 46.5 37 96 72"),
        ("intrinsics.txt", "# fx 0 cx\n88 0 46.5\n0 87 37\n0 0 1\n"),
        ("intrinsics.json", json.dumps({"K": CAMERA.K.tolist()})),
        ("intrinsics.json", json.dumps({"K": CAMERA.K.T.tolist(), "width": 96, "height": 72})),
        ("intrinsics.json", json.dumps({"depth": {"fx": 88, "fy": 87, "ppx": 46.5, "ppy": 37}, "depth_scale": 0.001})),
        (
            "intrinsics.yaml",
            f"image_width: 96\nimage_height: 72\ncamera_matrix:\n  data: [{ROWS}]\n",
        ),
        ("intrinsics.yml", f"%YAML:1.0\n---\nK: !!opencv-matrix\n  rows: 3\n  data: [{ROWS}]\n"),
        ("intrinsics.yaml", ORB_SLAM.format("Camera", "", 1000)),
        ("intrinsics.yaml", ORB_SLAM.format("Camera1", "RGBD.", 1000)),
    ],
)
def test_plain_intrinsics_in_many_spellings(name, text, tmp_path):
    write_plain(tmp_path, walk(2))
    (tmp_path / "intrinsics.yaml").unlink()
    (tmp_path / name).write_text(text)
    c = frames_of(tmp_path).frames[0].intrinsics
    assert (c.width, c.height, c.fx, c.fy, c.cx, c.cy) == (96, 72, 88, 87, 46.5, 37)


def test_plain_without_colour_is_a_capture_without_colour(tmp_path):
    write_plain(tmp_path, walk(3))
    for path in (tmp_path / "rgb").iterdir():
        path.unlink()
    capture = frames_of(tmp_path)
    assert not capture.has_color
    assert "there is no colour" in capture.assumptions


@pytest.mark.parametrize(
    ("color", "depth", "rule"),
    [
        ("color_{0}", "depth_{0}", "same number at the end"),
        ("{0:07d}-{1:06d}", "{0:07d}-{2:06d}", "same number at the beginning"),
        ("1548266469.{1:05d}", "1548266469.{2:05d}", "s apart"),
        ("15482664691{1:05d}77", "15482664691{2:05d}77", "s apart"),
    ],
)
def test_plain_pairs_files_by_number_or_time_where_names_differ(tmp_path, color, depth, rule):
    write_plain(tmp_path, walk(3))
    for folder, name in (("rgb", color), ("depth", depth)):
        for i, path in enumerate(sorted((tmp_path / folder).iterdir())):
            path.rename(path.with_stem(name.format(i, 10_000 * i, 10_000 * i + 700 * (i > 0))))
    capture = frames_of(tmp_path)
    assert len(capture) == 3
    assert any(rule in a for a in capture.assumptions)


def test_depth_smaller_than_colour_is_the_same_view_on_another_grid(tmp_path):
    write_plain(tmp_path, walk(3))
    for path in (tmp_path / "rgb").iterdir():
        image = cv2.imread(str(path))
        cv2.imwrite(str(path), cv2.resize(image, (192, 144)))
    frame = frames_of(tmp_path).frames[0]
    assert frame.color_intrinsics == frame.intrinsics.resized(192, 144)


def test_poses_can_be_ignored(tmp_path):
    write_open3d(tmp_path, walk(4))
    (tmp_path / "trajectory.log").write_text("rubbish")
    capture = frames_of(tmp_path, CaptureConfig(ignore_poses=True))
    assert len(capture) == 4
    assert not capture.has_poses


def test_exif_orientation_is_not_applied(tmp_path):
    """A phone held upright tags its pictures so that viewers turn them; the depth image has no such tag."""
    views = walk(3)
    write_plain(tmp_path, views)
    tag = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    for path in list((tmp_path / "rgb").iterdir()):
        jpeg = cv2.imencode(".jpg", cv2.imread(str(path)))[1].tobytes()
        path.unlink()
        marker = b"\xff\xe1" + (len(tag) + 2).to_bytes(2, "big") + tag
        path.with_suffix(".jpg").write_bytes(jpeg[:2] + marker + jpeg[2:])
    assert cv2.imread(str(tmp_path / "rgb/000000.jpg")).shape[:2] == (96, 72), "a viewer turns it"
    capture = frames_of(tmp_path)
    assert capture.dropped == ()
    color = capture.frames[0].color()
    assert color is not None
    assert color.shape == (72, 96, 3)


def test_tiff_and_16_bit_colour(tmp_path):
    views = walk(3)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        (tmp_path / f"depth/{i:06d}.png").unlink()
        depth = view.depth.astype(np.float32) if i == 1 else np.rint(view.depth * 1000).astype(np.uint16)
        assert cv2.imwrite(str(tmp_path / f"depth/{i:06d}.tiff"), depth)
        assert cv2.imwrite(str(tmp_path / f"rgb/{i:06d}.png"), view.color[..., ::-1].astype(np.uint16) * 257)
    for frame, view in zip(frames_of(tmp_path).frames, views, strict=True):
        np.testing.assert_allclose(frame.depth(), view.depth, atol=5.1e-4)
        np.testing.assert_array_equal(frame.color(), view.color)


def test_numpy_depth_in_metres(tmp_path):
    views = walk(3)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        (tmp_path / f"depth/{i:06d}.png").unlink()
        depth = view.depth.copy()
        depth[0, 0] = np.nan
        np.save(tmp_path / f"depth/{i:06d}.npy", depth)
    frame = frames_of(tmp_path).frames[1]
    np.testing.assert_allclose(frame.depth(), views[1].depth, atol=1e-6)


@pytest.mark.parametrize("name", ["rgbd_dataset_freiburg2_desk", "fr2_xyz"])
def test_the_cameras_of_tums_dataset_are_known_by_the_folders_name(tmp_path: Path, name: str) -> None:
    from realsim.capture.layouts.tum import published_camera, recognise

    folder = tmp_path / name
    folder.mkdir()
    camera = published_camera(folder)
    assert camera is not None
    assert (camera.fx, camera.cy, camera.width) == (520.9, 249.7, 640)
    assert published_camera(tmp_path / "frame_12") is None
    assert published_camera(tmp_path / "fr12") is None
    for file in ("rgb.txt", "depth.txt"):
        (folder / file).write_text("")
    assert recognise(folder).complete


def test_an_open3d_folder_without_a_camera_is_a_primesense_and_that_is_said(tmp_path):
    camera = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    write_open3d(tmp_path, walk(3, camera))
    (tmp_path / "camera_intrinsic.json").unlink()
    capture = frames_of(tmp_path)
    assert capture.layout == "open3d"
    assert capture.frames[0].intrinsics == camera
    assert any("no camera in the folder" in w for w in capture.warnings)


def test_the_default_camera_is_not_taken_for_images_of_another_size(tmp_path):
    write_open3d(tmp_path, walk(3))
    (tmp_path / "camera_intrinsic.json").unlink()
    with pytest.raises(CaptureError, match="no intrinsics"):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize("text", ['{"fx": 88, "fy": -87, "cx": 46.5, "cy": 37}', None])
def test_a_negative_fy_is_taken_with_y_down_and_that_is_said(tmp_path, text):
    write_plain(tmp_path, walk())
    K = CAMERA.K * [[1, 1, 1], [1, -1, 1], [1, 1, 1]]
    matrix = json.dumps({"intrinsic_matrix": K.T.ravel().tolist()})
    (tmp_path / "intrinsics.json").write_text(text or matrix)
    capture = frames_of(tmp_path)
    assert capture.frames[0].intrinsics == CAMERA
    assert any("y axis points up" in a for a in capture.assumptions)


def test_a_layout_of_ones_own_that_answers_wrongly_is_told_how() -> None:
    with pytest.raises(CaptureError, match="no tuple of texts"):
        Recognition(True, "3 x shot_*.npz")  # type: ignore[arg-type]
