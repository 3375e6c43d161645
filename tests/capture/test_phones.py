"""The traps of the phone apps' formats: axes, worlds, units, archives, videos, what each version writes differently."""

import json
import zipfile

import cv2
import numpy as np
import pytest

from realsim.capture import CaptureConfig, read
from realsim.capture.arkit import from_opengl, pose_xyzw
from realsim.capture.video import VideoFrame
from realsim.core.errors import CaptureError, MissingExtraError, PoseError, RealsimError
from realsim.core.geometry import R_to_quat, exp_so3, make_T, transform

from .damage import cut, reason
from .scene import CAMERA, walk
from .test_layouts import CONFIG, frames_of
from .writers import (
    ODOMETRY,
    OF_COLOR,
    WRITERS,
    millimetres,
    record3d_members,
    write_arkitscenes,
    write_image,
    write_nerfstudio,
    write_polycam,
    write_record3d,
    write_record3d_exr,
    write_scannerapp,
    write_stray,
    write_zip,
)

UP_Y = ("polycam", "scannerapp", "record3d", "record3d_exr", "stray")
PHONES = {name: WRITERS[name] for name in (*UP_Y, "arkitscenes")}


def test_opengl_axes_by_hand():
    """A camera at the origin that looks along world -z with y up sees what is ahead at positive optical depth."""
    T = from_opengl(np.eye(4))
    ahead, above, right = transform(np.linalg.inv(T), np.array([[0.0, 0, -2], [0, 1, 0], [1, 0, 0]]))
    np.testing.assert_allclose(ahead, [0, 0, 2])
    np.testing.assert_allclose(above, [0, -1, 0])
    np.testing.assert_allclose(right, [1, 0, 0])


def test_quaternions_have_their_real_part_last():
    R = exp_so3([0.3, -0.2, 0.5])
    w, x, y, z = R_to_quat(R)
    np.testing.assert_allclose(pose_xyzw([1, 2, 3, x, y, z, w]), make_T(R, [1, 2, 3]), atol=1e-12)
    with pytest.raises(PoseError, match="quaternion"):
        pose_xyzw([1, 2, 3, 0, 0, 0, 0])


@pytest.mark.parametrize("name", PHONES)
def test_phones_know_up_and_how_sure_they_are(name, tmp_path):
    views = walk(4)
    PHONES[name](tmp_path, views)
    capture = frames_of(tmp_path)
    np.testing.assert_array_equal(capture.up_world, [0, 1, 0] if name in UP_Y else [0, 0, 1])
    if name != "record3d_exr":
        sure = capture.frames[0].read_confidence
        assert sure is not None
        hole = sure()[views[0].depth == 0]
        assert hole.max() <= 0.5, "ARKit's middle level is a half"
    assert frames_of(tmp_path, CaptureConfig(ignore_poses=True)).up_world is None
    assert not frames_of(tmp_path, CaptureConfig(ignore_poses=True)).has_poses


@pytest.mark.parametrize("name", PHONES)
def test_files_that_many_frames_share_are_named_once(name, tmp_path):
    PHONES[name](tmp_path, walk(4))
    files = [f for frame in frames_of(tmp_path).frames for f in frame.files]
    assert len(files) == len(set(files)) > 0


# ---------------------------------------------------------------- nerfstudio


def edit(path, change) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_nerfstudio_intrinsics_of_each_frame(tmp_path):
    write_nerfstudio(tmp_path, walk(4))

    def change(data):
        own = {key: data.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
        for i, frame in enumerate(data["frames"]):
            frame.update(own, fl_x=own["fl_x"] + i)

    edit(tmp_path / "transforms.json", change)
    # The list in the file runs backward.
    assert [f.intrinsics.fx for f in frames_of(tmp_path).frames] == [91, 90, 89, 88]


def test_nerfstudio_frame_without_a_camera_costs_that_frame(tmp_path):
    write_nerfstudio(tmp_path, walk(4))

    def change(data):
        own = {key: data.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
        for frame in data["frames"][1:]:
            frame.update(own)

    edit(tmp_path / "transforms.json", change)
    assert "no camera parameters" in reason(frames_of(tmp_path), "frame_00004")


def test_nerfstudio_applied_scale_is_taken_back(tmp_path):
    views = walk(4)
    write_nerfstudio(tmp_path, views)

    def change(data):
        data["applied_scale"] = 0.25
        for frame in data["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= 0.25

    edit(tmp_path / "transforms.json", change)
    capture = frames_of(tmp_path)
    np.testing.assert_allclose(capture.frames[2].T_world_camera, views[2].T_world_camera, atol=1e-9)
    assert any("applied_scale 0.25" in a for a in capture.assumptions)


def test_nerfstudio_arrays_are_in_the_same_unit_as_images(tmp_path):
    views = walk(3)
    write_nerfstudio(tmp_path, views)
    for i, view in enumerate(views):
        np.save(tmp_path / f"depths/frame_{i + 1:05d}.npy", (1000 * view.depth).astype(np.float32))
    edit(
        tmp_path / "transforms.json",
        lambda d: [f.update(depth_file_path=f["depth_file_path"].replace("png", "npy")) for f in d["frames"]],
    )
    np.testing.assert_allclose(frames_of(tmp_path).frames[1].depth(), views[1].depth, atol=1e-5)


def test_nerfstudio_distortion_is_warned_of_and_fisheye_refused(tmp_path):
    write_nerfstudio(tmp_path, walk(3))
    edit(tmp_path / "transforms.json", lambda d: d.update(k1=0.02))
    capture = frames_of(tmp_path)
    assert sum("lens distortion" in w for w in capture.warnings) == 1
    edit(tmp_path / "transforms.json", lambda d: d.update(camera_model="OPENCV_FISHEYE"))
    with pytest.raises(CaptureError, match="no frame of this capture") as caught:
        read(tmp_path, CONFIG)
    assert "not a pinhole camera" in str(caught.value)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd"])
@pytest.mark.parametrize("key", ["file_path", "depth_file_path"])
def test_nerfstudio_names_stay_in_the_folder(name, key, tmp_path):
    write_nerfstudio(tmp_path / "capture", walk(3))
    edit(tmp_path / "capture/transforms.json", lambda d: d["frames"][0].update({key: name}))
    with pytest.raises(RealsimError, match="leads out of its folder"):
        read(tmp_path / "capture", CONFIG)


def test_nerfstudio_without_intrinsics(tmp_path):
    write_nerfstudio(tmp_path, walk(3))
    edit(tmp_path / "transforms.json", lambda d: d.pop("fl_x"))
    with pytest.raises(CaptureError, match="no intrinsics"):
        read(tmp_path, CONFIG)


def test_nerfstudio_without_depth(tmp_path):
    write_nerfstudio(tmp_path, walk(3))
    edit(tmp_path / "transforms.json", lambda d: [f.pop("depth_file_path") for f in d["frames"]])
    for config in (CONFIG, CaptureConfig(layout="nerfstudio")):
        with pytest.raises(CaptureError, match="colour without depth"):
            read(tmp_path, config)


@pytest.mark.parametrize("frames", [None, [], {}, "all", [1, 2], [{"file_path": 3}], [{}]])
def test_nerfstudio_frames_that_are_none(frames, tmp_path):
    write_nerfstudio(tmp_path, walk(3))
    edit(tmp_path / "transforms.json", lambda d: d.update(frames=frames, note='"depth_file_path"'))
    with pytest.raises(CaptureError):
        read(tmp_path, CaptureConfig(layout="nerfstudio"))


def test_nerfstudio_poses_already_in_opencv_axes_are_found_out(tmp_path):
    views = walk(10)
    write_nerfstudio(tmp_path, views)

    def change(data):
        for frame, view in zip(data["frames"], views[::-1], strict=True):
            frame["transform_matrix"] = view.T_world_camera.tolist()

    edit(tmp_path / "transforms.json", change)
    with pytest.raises(PoseError, match="OpenGL camera axes"):
        read(tmp_path, CONFIG)


# ---------------------------------------------------------------- Polycam, 3D Scanner App


def test_polycam_says_whether_it_is_corrected(tmp_path):
    views = walk(4)
    write_polycam(tmp_path / "a", views, "")
    assert any("no corrected images" in a for a in frames_of(tmp_path / "a").assumptions)
    # Where there are both, the corrected ones are taken.
    write_polycam(tmp_path / "a", walk(5)[1:], "")
    write_polycam(tmp_path / "a", views, "corrected_")
    capture = frames_of(tmp_path / "a")
    assert any("undistorted" in a for a in capture.assumptions)
    np.testing.assert_allclose(capture.frames[0].T_world_camera, views[0].T_world_camera, atol=1e-9)


def test_polycam_is_recognised_from_inside_and_beside_its_mesh(tmp_path):
    write_polycam(tmp_path, walk(3))
    (tmp_path / "raw.glb").write_bytes(b"glTF")
    assert frames_of(tmp_path).layout == frames_of(tmp_path / "keyframes").layout == "polycam"


def test_polycam_broken_camera_costs_its_frame(tmp_path):
    views = walk(4)
    write_polycam(tmp_path, views)
    name = f"{round(views[2].time * 1e6)}"
    edit(tmp_path / f"keyframes/corrected_cameras/{name}.json", lambda d: d.pop("t_12"))
    assert "no camera pose" in reason(frames_of(tmp_path), name)


def test_scannerapp_frames_without_colour_are_not_lost_frames(tmp_path):
    write_scannerapp(tmp_path, walk(6))
    for i in (1, 2, 4):
        (tmp_path / f"frame_{i:05d}.jpg").unlink()
    capture = frames_of(tmp_path)
    assert [f.name for f in capture.frames] == ["00000", "00003", "00005"]
    assert capture.dropped == ()
    assert any("3 depth images have no colour" in a for a in capture.assumptions)


def test_damaged_confidence_costs_its_frame(tmp_path):
    write_scannerapp(tmp_path, walk(5))
    write_image(tmp_path / "conf_00001.png", np.full((CAMERA.height, CAMERA.width), 200, np.uint8))
    write_image(tmp_path / "conf_00003.png", np.full((10, 10), 2, np.uint8))
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["00001", "00003"]
    assert "0 to 2" in capture.dropped[0].reason
    assert "confidence of another size" in capture.dropped[1].reason


# ---------------------------------------------------------------- Record3D


def r3d(tmp_path):
    return next(tmp_path.glob("*.r3d"))


def test_record3d_file_or_folder(tmp_path):
    write_record3d(tmp_path, walk(3))
    by_file, by_folder = frames_of(r3d(tmp_path)), frames_of(tmp_path)
    assert [f.read_depth for f in by_file.frames] == [f.read_depth for f in by_folder.frames]


@pytest.mark.parametrize("share", [0.2, 0.7, 0.99])
def test_record3d_truncated_archive(share, tmp_path):
    write_record3d(tmp_path, walk(3))
    cut(r3d(tmp_path), share)
    with pytest.raises(CaptureError, match="not a zip archive, or cut off"):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize("name", ["../../etc/cron.d/x", "/etc/passwd", "..\\x"])
def test_record3d_archive_with_names_that_lead_out(name, tmp_path):
    write_zip(tmp_path / "a.r3d", {**record3d_members(walk(2)), name: b"x"})
    with pytest.raises(CaptureError, match="leads out"):
        read(tmp_path, CONFIG)


def test_record3d_depth_that_is_no_lzfse_costs_its_frame(tmp_path):
    members = record3d_members(walk(6))
    members["rgbd/1.depth"] = b"garbage" * 100
    members["rgbd/3.depth"] = members["rgbd/3.depth"][:-40]
    members["rgbd/4.depth"] = members["rgbd/4.conf"]
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000001", "000003", "000004"]
    assert all("corrupt or truncated depth" in d.reason for d in capture.dropped)


def test_record3d_bombs_are_not_unpacked(tmp_path):
    lzfse = pytest.importorskip("lzfse")
    members = record3d_members(walk(4))
    members["rgbd/1.depth"] = lzfse.compress(bytes(1_000_000))
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    assert "unpack to 1000000 bytes instead of 27648" in reason(capture, "000001")
    # A member that unpacks beyond its limit: the metadata, here.
    with zipfile.ZipFile(tmp_path / "b.r3d", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in record3d_members(walk(2)).items():
            archive.writestr(name, data if name != "metadata" else b" " * (65 * 2**20))
    with pytest.raises(CaptureError, match="too large"):
        read(tmp_path / "b.r3d", CONFIG)


def test_record3d_old_files_do_not_say_the_depth_size(tmp_path):
    lzfse = pytest.importorskip("lzfse")
    members = record3d_members(walk(3))
    meta = json.loads(members["metadata"])
    del meta["dw"], meta["dh"], meta["perFrameIntrinsicCoeffs"]
    meta["w"], meta["h"] = 144, 192
    meta["K"] = [170.0, 0, 0, 0, 170, 0, 72, 96, 1]
    members["metadata"] = json.dumps(meta).encode()
    for i in range(3):
        members[f"rgbd/{i}.depth"] = lzfse.compress(np.full((256, 192), 1.0 + i / 8, "<f4").tobytes())
        members[f"rgbd/{i}.jpg"] = cv2.imencode(".jpg", np.full((192, 144, 3), 90 * i, np.uint8))[1].tobytes()
        del members[f"rgbd/{i}.conf"]
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path, CaptureConfig(ignore_poses=True))
    c = capture.frames[0].intrinsics
    assert (c.width, c.height) == (192, 256), "upright, like the colour image"
    assert c.fx == pytest.approx(170 * 192 / 144)


def test_record3d_poses_relative_to_the_first_do_not_tell_up(tmp_path):
    views = walk(4)
    members = record3d_members(views)
    meta = json.loads(members["metadata"])
    meta["poses"][0] = [0, 0, 0, 1, 0, 0, 0]
    members["metadata"] = json.dumps(meta).encode()
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    assert capture.up_world is None
    assert any("up is not known" in a for a in capture.assumptions)


@pytest.mark.parametrize("first", [[0, 0, 0, 0, 0, 0, 0], [float("nan")] * 7])
def test_record3d_bad_first_pose_costs_its_frame(first, tmp_path):
    members = record3d_members(walk(5))
    meta = json.loads(members["metadata"])
    meta["poses"][0] = first
    members["metadata"] = json.dumps(meta).encode()
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000000"]
    assert capture.has_poses
    assert capture.up_world is None
    assert any("first pose cannot be read" in a for a in capture.assumptions)


def test_record3d_fewer_poses_than_frames(tmp_path):
    members = record3d_members(walk(6))
    meta = json.loads(members["metadata"])
    meta["poses"] = meta["poses"][:4]
    members["metadata"] = json.dumps(meta).encode()
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000004", "000005"]
    assert "no pose" in capture.dropped[0].reason


def test_record3d_names_the_extra(tmp_path, monkeypatch):
    write_record3d(tmp_path, walk(2))
    monkeypatch.setitem(__import__("sys").modules, "lzfse", None)
    with pytest.raises(MissingExtraError, match=r"\[phone\]"):
        read(tmp_path, CONFIG)


def test_record3d_exr_damage_and_type(tmp_path):
    write_record3d_exr(tmp_path, walk(6))
    root = tmp_path / "EXR_RGBD"
    cut(root / "depth/1.exr", 0.5)
    (root / "depth/3.exr").write_bytes(b"not an image")
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000001", "000003"]
    assert all("corrupt or truncated" in d.reason for d in capture.dropped)


# ---------------------------------------------------------------- Stray Scanner


@pytest.mark.parametrize(
    "header",
    [
        "x, y, z, qx, qy, qz, qw",
        "timestamp, frame, x, y, z, qx, qy, qz, qw",
        "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy",
        ODOMETRY,
    ],
)
@pytest.mark.parametrize("depth", ["png", "npy"])
def test_stray_headers_of_all_versions(header, depth, tmp_path):
    views = walk(5)
    write_stray(tmp_path, views, header, depth)
    capture = frames_of(tmp_path)
    assert len(capture) == 5
    for frame, view in zip(capture.frames, views, strict=True):
        np.testing.assert_allclose(frame.T_world_camera, view.T_world_camera, atol=1e-6)
        np.testing.assert_allclose(frame.depth(), view.depth, atol=0.0005 + 1e-6)
        assert (frame.timestamp is not None) == ("timestamp" in header)
    assert any("intrinsics of its own" in a for a in capture.assumptions) == ("fx" in header)


def test_stray_first_version_without_a_header(tmp_path):
    views = walk(4)
    write_stray(tmp_path, views, "x, y, z, qx, qy, qz, qw")
    lines = (tmp_path / "odometry.csv").read_text().splitlines()
    (tmp_path / "odometry.csv").write_text("\n".join(lines[1:]))
    np.testing.assert_allclose(frames_of(tmp_path).frames[3].T_world_camera, views[3].T_world_camera, atol=1e-6)


def test_stray_own_cameras_win_over_the_last_frames(tmp_path):
    write_stray(tmp_path, walk(3))
    (tmp_path / "camera_matrix.csv").write_text("200, 0, 96\n0, 200, 72\n0, 0, 1")
    assert frames_of(tmp_path).frames[0].color_intrinsics.fx == pytest.approx(OF_COLOR.fx)


def test_stray_video_shorter_than_the_odometry(tmp_path):
    from .writers import enlarged, write_video

    views = walk(6)
    write_stray(tmp_path, views)
    write_video(tmp_path / "rgb.mp4", [enlarged(v) for v in views[:4]])
    capture = frames_of(tmp_path)
    assert len(capture) == 4
    assert [d.name for d in capture.dropped] == ["000004", "000005"]
    assert all("video ends before" in d.reason for d in capture.dropped)
    assert any("4 images for 6 poses" in w for w in capture.warnings)


@pytest.mark.parametrize(
    ("row", "said"), [("1, 2, 3", "wrong length"), ("0, x" + ", 0" * 13, "frame number"), (ODOMETRY, "frame number")]
)
def test_stray_broken_odometry(row, said, tmp_path):
    write_stray(tmp_path, walk(3))
    with (tmp_path / "odometry.csv").open("a") as file:
        file.write(row)
    with pytest.raises(PoseError, match=said):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize("column", ["timestamp", "qx", "fx"])
def test_stray_bad_row_costs_its_frame(column, tmp_path):
    write_stray(tmp_path, walk(5))
    lines = (tmp_path / "odometry.csv").read_text().splitlines()
    words = lines[3].split(", ")
    words[lines[0].split(", ").index(column)] = "oops"
    (tmp_path / "odometry.csv").write_text("\n".join([*lines[:3], ", ".join(words), *lines[4:]]) + "\n")
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000002"]
    assert "not a number" in capture.dropped[0].reason
    assert any("intrinsics of its own" in a for a in capture.assumptions)


def test_stray_odometry_of_another_kind(tmp_path):
    write_stray(tmp_path, walk(3))
    (tmp_path / "odometry.csv").write_text("timestamp, px, py, pz\n1, 2, 3, 4\n")
    with pytest.raises(PoseError, match="header is not known"):
        read(tmp_path, CONFIG)
    assert not frames_of(tmp_path, CaptureConfig(ignore_poses=True)).has_poses


def test_a_video_gives_the_same_frame_in_any_order(tmp_path):
    views = walk(30)
    write_stray(tmp_path, views)
    order = [*range(0, 30, 2), *range(1, 30, 2), 29, 0, 15, 14, 13, 15, 28]
    for k in order:
        image = VideoFrame(tmp_path / "rgb.mp4", k)()
        np.testing.assert_array_equal(image[::2, ::2], views[k].color)


def test_a_video_is_read_by_two_threads(tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    views = walk(20)
    write_stray(tmp_path, views)
    with ThreadPoolExecutor(2) as pool:
        images = list(pool.map(lambda k: VideoFrame(tmp_path / "rgb.mp4", k)(), range(20)))
    for image, view in zip(images, views, strict=True):
        np.testing.assert_array_equal(image[::2, ::2], view.color)


# ---------------------------------------------------------------- ARKitScenes


def test_arkitscenes_in_the_detection_subset(tmp_path):
    write_arkitscenes(tmp_path / "41069021_frames", walk(3))
    (tmp_path / "41069021_3dod_mesh.ply").write_text("ply")
    assert frames_of(tmp_path).layout == "arkitscenes"


def test_arkitscenes_frames_between_poses_are_interpolated_or_dropped(tmp_path):
    views = walk(8)
    write_arkitscenes(tmp_path, views)
    lines = (tmp_path / "lowres_wide.traj").read_text().splitlines()
    (tmp_path / "lowres_wide.traj").write_text("\n".join(lines[:3] + lines[4:]))
    capture = frames_of(tmp_path)
    assert "no pose" in capture.dropped[0].reason
    assert len(capture) == 7
    near = frames_of(tmp_path, CaptureConfig(max_pose_gap=0.25)).frames[3].T_world_camera
    assert near is not None
    assert np.abs(near - views[3].T_world_camera).max() < 0.01


def test_arkitscenes_trajectory_is_world_to_camera(tmp_path):
    """By hand: camera at (1, 2, 3) without rotation is the translation (-1, -2, -3) in the file."""
    views = walk(2)
    write_arkitscenes(tmp_path, views)
    lines = (tmp_path / "lowres_wide.traj").read_text().splitlines()
    stamp = lines[0].split()[0]
    (tmp_path / "lowres_wide.traj").write_text(f"{stamp} 0 0 0 -1 -2 -3\n")
    frame = frames_of(tmp_path).frames[0]
    np.testing.assert_allclose(frame.T_world_camera, make_T(None, [1, 2, 3]))


def test_depth_of_phones_in_another_unit_is_found(tmp_path):
    views = walk(10)
    write_stray(tmp_path, views)
    for i, view in enumerate(views):
        write_image(tmp_path / f"depth/{i:06d}.png", millimetres(view.depth, 5000))
    with pytest.raises(CaptureError, match="implausible unit"):
        read(tmp_path, CONFIG)
    np.testing.assert_allclose(
        frames_of(tmp_path, CaptureConfig(depth_unit=0.0002)).frames[2].depth(), views[2].depth, atol=2e-4
    )


@pytest.mark.parametrize("lost", ["depth", "jpg", "conf"])
def test_a_member_that_is_missing_in_a_recording_is_said(lost, tmp_path):
    members = record3d_members(walk(5))
    del members[f"rgbd/2.{lost}"]
    write_zip(tmp_path / "a.r3d", members)
    capture = frames_of(tmp_path)
    if lost == "conf":
        assert any("1 of 5 frames have no confidence" in w for w in capture.warnings)
    else:
        assert [d.name for d in capture.dropped] == ["000002"]


def test_a_camera_unlike_all_others_is_named(tmp_path):
    views = walk(6)
    PHONES["arkitscenes"](tmp_path, views)
    assert not any("unlike" in w for w in frames_of(tmp_path).warnings)
    path = sorted((tmp_path / "lowres_wide_intrinsics").iterdir())[2]
    path.write_text(path.read_text().replace("46.5", "66.5"))
    assert any("1 of 6 frames have a camera unlike" in w for w in frames_of(tmp_path).warnings)
