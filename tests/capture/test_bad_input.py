"""Damaged single frames are dropped and named, the rest goes on; what is wrong as a whole is an error that helps."""

from __future__ import annotations

import contextlib
import os
import shutil
import threading

import cv2
import numpy as np
import pytest

from realsim.capture import CaptureConfig, inspect, read
from realsim.errors import CaptureError, PoseError, RealsimError

from .scene import CAMERA, walk
from .test_layouts import CONFIG, EVERY, frames_of
from .writers import (
    WRITERS,
    camera_points,
    millimetres,
    write_image,
    write_log,
    write_open3d,
    write_pcd,
    write_pcd_folder,
    write_plain,
    write_sevenscenes,
    write_tum,
)


def reason(capture, name: str) -> str:
    """Why the frame of that name was dropped; also that only it was."""
    assert [d.name for d in capture.dropped] == [name]
    assert name not in {f.name for f in capture.frames}
    return capture.dropped[0].reason


# ---------------------------------------------------------------- folders


def test_missing_folder(tmp_path):
    with pytest.raises(CaptureError, match="does not exist"):
        read(tmp_path / "nowhere", CONFIG)


def test_empty_folder(tmp_path):
    with pytest.raises(CaptureError, match="the folder is empty"):
        read(tmp_path, CONFIG)


def test_colour_without_depth(tmp_path):
    for name in ("open3d", "tum", "sevenscenes", "scannet", "plain"):
        folder = tmp_path / name
        WRITERS[name](folder, walk(3))
        shutil.rmtree(folder / "depth", ignore_errors=True)
        for path in [*folder.glob("*.depth.png"), *folder.glob("depth.txt")]:
            path.unlink()
        for config in (CONFIG, CaptureConfig(layout=name)):
            with pytest.raises(CaptureError, match="colour without depth"):
                read(folder, config)


def test_no_intrinsics(tmp_path):
    for name in ("open3d", "tum", "sevenscenes", "scannet", "plain"):
        folder = tmp_path / name / "capture"
        WRITERS[name](folder, walk(3))
        shutil.rmtree(folder / "intrinsic", ignore_errors=True)
        for pattern in ("*intrinsic*", "calibration.txt"):
            for path in folder.glob(pattern):
                path.unlink()
        for config in (CONFIG, CaptureConfig(layout=name)):
            with pytest.raises(CaptureError, match="no intrinsics"):
                read(folder, config)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "no camera parameters"),
        ('{"fx": "wide"}', "no camera parameters"),
        ('{"fx": "wide", "fy": 1, "cx": 1, "cy": 1}', "not a number"),
        ('{"K": [1, 2, 3]}', "wrong length"),
        ('{"K": [88, 0, 0, 0, 87, 0, 0, 0, 1]}', "not a camera matrix"),
        ('{"K": [88, 0, 46, 0, 87, 37, 46, 37, 1]}', "not a camera matrix"),
        ('{"fx": -88, "fy": 87, "cx": 46, "cy": 37}', "cannot belong"),
        ('{"fx": 880, "fy": 870, "cx": 465, "cy": 370}', "principal point inside"),
        ('{"fx": 8.8, "fy": 87, "cx": 46, "cy": 37}', "fx and fy of similar size"),
        ('{"fx": 88, "fy": 87, "cx": 46, "cy": 37, "width": 640, "height": 480}', "another size than their intrinsics"),
        ('{"fx": 88, "fy": 87, "cx": NaN, "cy": 37}', "cannot belong"),
        ('{"fx": 88, "fy": 87, "cx": 46, "cy": 37, "depth_scale": 0}', "not positive"),
        ('{"fx": 88, "fy": 87, "cx": 46, "cy": 37, "width": NaN, "height": 75}', "not a number of pixels"),
        ('{"fx": 88, "fy": 87, "cx": 46, "cy": 37, "width": 96, "height": Infinity}', "not a number of pixels"),
        ('{"fx": 1' + "0" * 400 + ', "fy": 87, "cx": 46, "cy": 37}', "401 digits"),
        ("[" * 100_000, "broken JSON"),
        ('{"fx": 88,', "broken JSON"),
    ],
)
def test_intrinsics_that_cannot_be(text, said, tmp_path):
    write_plain(tmp_path, walk(3))
    (tmp_path / "intrinsics.yaml").unlink()
    (tmp_path / "intrinsics.json").write_text(text)
    with pytest.raises(RealsimError, match=said) as caught:
        read(tmp_path, CONFIG)
    assert "intrinsics.json" in str(caught.value.file)


@pytest.mark.parametrize("size", ["nan nan", "96 inf"])
def test_a_camera_in_a_line_of_text_without_a_size(size, tmp_path):
    write_plain(tmp_path, walk(3))
    (tmp_path / "intrinsics.yaml").unlink()
    (tmp_path / "intrinsics.txt").write_text(f"88 87 46 37 {size}")
    with pytest.raises(CaptureError, match="not a number of pixels"):
        read(tmp_path, CONFIG)


def test_a_name_that_leads_out_of_the_folder_is_refused(tmp_path):
    write_tum(tmp_path / "capture", walk(3))
    text = (tmp_path / "capture/rgb.txt").read_text()
    (tmp_path / "capture/rgb.txt").write_text(text.replace("rgb/", "../rgb/", 1))
    with pytest.raises(RealsimError, match="leads out of its folder"):
        read(tmp_path / "capture", CONFIG)


# ---------------------------------------------------------------- images


def cut(path, share=0.6):
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
@pytest.mark.parametrize("which", ["color", "depth"])
def test_truncated_image(share, which, tmp_path):
    write_open3d(tmp_path, walk(6))
    cut(tmp_path / which / "000002.png", share)
    assert "corrupt or truncated image" in reason(frames_of(tmp_path), "000002")


def test_truncated_jpeg_is_noticed_although_it_decodes(tmp_path):
    write_plain(tmp_path, walk(6))
    for path in (tmp_path / "rgb").iterdir():
        write_image(path.with_suffix(".jpg"), cv2.imread(str(path))[..., ::-1])
        path.unlink()
    cut(tmp_path / "rgb/000003.jpg", 0.8)
    assert "cut off" in reason(frames_of(tmp_path), "000003")


def test_flipped_bits_in_a_png(tmp_path):
    write_open3d(tmp_path, walk(6))
    path = tmp_path / "depth/000004.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    assert "checksum" in reason(frames_of(tmp_path), "000004")


def test_a_text_file_called_png(tmp_path):
    write_open3d(tmp_path, walk(6))
    (tmp_path / "color/000001.png").write_text("<html>404</html>")
    assert "corrupt" in reason(frames_of(tmp_path), "000001")


def test_a_png_that_promises_gigapixels(tmp_path):
    import struct
    import zlib

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    write_open3d(tmp_path, walk(6))
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 16, 0, 0, 0, 0)
    bomb = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    (tmp_path / "depth/000001.png").write_bytes(bomb)
    assert "60000x60000" in reason(frames_of(tmp_path), "000001")


def test_depth_of_another_size(tmp_path):
    views = walk(8)
    write_open3d(tmp_path, views)
    write_image(tmp_path / "depth/000005.png", millimetres(views[5].depth)[::2, ::2])
    said = reason(frames_of(tmp_path), "000005")
    assert "depth of another size" in said
    assert "96x72" in said
    assert "48x36" in said


@pytest.mark.parametrize("kind", ["eight bits", "three channels", "signed", "one row", "archive"])
def test_depth_of_another_type(kind, tmp_path):
    views = walk(8)
    write_plain(tmp_path, views)
    path = tmp_path / "depth/000005.png"
    raw = millimetres(views[5].depth)
    if kind in ("signed", "one row"):
        path.unlink()
        np.save(path.with_suffix(".npy"), raw.astype(np.int32) if kind == "signed" else raw.ravel())
    elif kind == "archive":
        path.unlink()
        np.savez(path.with_suffix(".npz"), raw)
        path.with_suffix(".npz").rename(path.with_suffix(".npy"))
    else:
        write_image(path, (raw // 16).astype(np.uint8) if kind == "eight bits" else np.repeat(raw[..., None], 3, 2))
    expected = "corrupt array" if kind == "archive" else "depth of another type"
    assert expected in reason(frames_of(tmp_path), "000005")


def test_pickled_arrays_are_not_opened(tmp_path):
    views = walk(5)
    write_plain(tmp_path, views)
    (tmp_path / "depth/000002.png").unlink()
    np.save(tmp_path / "depth/000002.npy", np.array([{"code": "x"}], dtype=object), allow_pickle=True)
    assert "corrupt array" in reason(frames_of(tmp_path), "000002")


def test_frames_without_a_partner(tmp_path):
    write_open3d(tmp_path, walk(8))
    (tmp_path / "color/000003.png").unlink()
    (tmp_path / "depth/000006.png").unlink()
    capture = frames_of(tmp_path)
    assert {(d.name, d.reason) for d in capture.dropped} == {
        ("000003", "depth without colour"),
        ("000006", "colour without depth"),
    }
    np.testing.assert_allclose(capture.frames[3].T_world_camera, walk(8)[4].T_world_camera, atol=1e-9)


def test_all_invalid_depth(tmp_path):
    write_open3d(tmp_path, walk(6))
    write_image(tmp_path / "depth/000003.png", np.zeros((72, 96), np.uint16))
    write_image(tmp_path / "depth/000004.png", np.full((72, 96), 65535, np.uint16))
    capture = frames_of(tmp_path)
    assert [d.name for d in capture.dropped] == ["000003", "000004"]
    assert all("no valid depth" in d.reason for d in capture.dropped)


def test_hardly_any_depth(tmp_path):
    write_open3d(tmp_path, walk(6))
    raw = np.zeros((72, 96), np.uint16)
    raw[10, 10:20] = 1500
    write_image(tmp_path / "depth/000003.png", raw)
    assert "hardly any valid depth" in reason(frames_of(tmp_path), "000003")


def test_nothing_left_is_an_error_that_says_why(tmp_path):
    write_plain(tmp_path, walk(4))
    for path in (tmp_path / "depth").iterdir():
        write_image(path, np.zeros((72, 96), np.uint16))
    with pytest.raises(CaptureError, match="4 x no valid depth"):
        read(tmp_path, CONFIG)


def test_duplicate_frames(tmp_path):
    write_plain(tmp_path, walk(6))
    for which in ("rgb", "depth"):
        shutil.copy(tmp_path / which / "000002.png", tmp_path / which / "000003.png")
    capture = frames_of(tmp_path)
    assert reason(capture, "000003") == "the same images as 000002"
    assert not capture.dropped[0].lost


def test_blurred_frame(tmp_path):
    views = walk(10)
    write_plain(tmp_path, views)
    write_image(tmp_path / "rgb/000004.png", cv2.GaussianBlur(views[4].color, (0, 0), 2.5))
    assert "blurred" in reason(frames_of(tmp_path), "000004")
    assert len(frames_of(tmp_path, CaptureConfig(keep_blurred=True))) == 10


def test_a_whole_soft_capture_is_not_blurred_against_itself(tmp_path):
    views = walk(10)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        write_image(tmp_path / f"rgb/{i:06d}.png", cv2.GaussianBlur(view.color, (0, 0), 2.5))
    assert len(frames_of(tmp_path)) == 10


def test_pictures_without_any_detail_are_not_blurred(tmp_path):
    write_plain(tmp_path, walk(6))
    for i in range(6):
        write_image(tmp_path / f"rgb/{i:06d}.png", np.full((72, 96, 3), 40 * i, np.uint8))
    assert len(frames_of(tmp_path)) == 6


# ---------------------------------------------------------------- depth unit


@pytest.mark.parametrize("steps", [1.0, 50_000.0])
def test_depth_in_an_implausible_unit(steps, tmp_path):
    views = walk(4)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        write_image(tmp_path / f"depth/{i:06d}.png", np.rint(view.depth * steps / 5).astype(np.uint16))
    with pytest.raises(CaptureError, match="implausible unit") as caught:
        read(tmp_path, CONFIG)
    assert caught.value.expected is not None


def test_float_depth_in_millimetres(tmp_path):
    views = walk(4)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        (tmp_path / f"depth/{i:06d}.png").unlink()
        np.save(tmp_path / f"depth/{i:06d}.npy", (1000 * view.depth).astype(np.float32))
    with pytest.raises(CaptureError, match="implausible unit") as caught:
        read(tmp_path, CONFIG)
    assert "millimetres" in str(caught.value.hint)
    assert "--depth-unit 0.001" in str(caught.value.hint)
    capture = frames_of(tmp_path, CaptureConfig(depth_unit=0.001))
    np.testing.assert_allclose(capture.frames[0].depth(), views[0].depth, atol=1e-5)


def test_tum_depth_read_as_millimetres_is_found_by_the_poses(tmp_path):
    views = walk(10)
    write_open3d(tmp_path, views)
    for i, view in enumerate(views):
        write_image(tmp_path / f"depth/{i:06d}.png", millimetres(view.depth, 5000))
    with pytest.raises(CaptureError, match="implausible unit") as caught:
        read(tmp_path, CONFIG)
    assert "--depth-unit 0.0002" in str(caught.value)
    capture = frames_of(tmp_path, CaptureConfig(depth_unit=0.0002))
    np.testing.assert_allclose(capture.frames[0].depth(), views[0].depth, atol=2e-4)


def test_range_limits(tmp_path):
    views = walk(3)
    write_plain(tmp_path, views)
    near, far = np.percentile(views[0].depth[views[0].depth > 0], [20, 80])
    depth = frames_of(tmp_path, CaptureConfig(min_depth=near, max_depth=far)).frames[0].depth()
    kept = depth[depth > 0]
    assert kept.min() >= near
    assert kept.max() <= far
    assert 0.5 < len(kept) / (views[0].depth > 0).sum() < 0.7


# ---------------------------------------------------------------- poses


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


# ---------------------------------------------------------------- point clouds


@pytest.mark.parametrize("share", [0.001, 0.5, 0.999])
def test_truncated_point_cloud(share, tmp_path):
    write_pcd_folder(tmp_path, walk(5))
    cut(tmp_path / "cloud002.pcd", share)
    said = reason(frames_of(tmp_path), "cloud002")
    assert "truncated" in said or "not a PCD file" in said


def test_clouds_that_fit_no_camera(tmp_path):
    rng = np.random.default_rng(0)
    write_pcd(tmp_path / "a.pcd", rng.uniform(0.5, 2, (40, 50, 3)))
    with pytest.raises(CaptureError, match="no camera's pixel grid"):
        read(tmp_path, CONFIG)


def test_unorganised_clouds(tmp_path):
    for name in ("a", "b"):
        write_pcd(tmp_path / f"{name}.pcd", np.ones((1, 50, 3)))
    with pytest.raises(CaptureError, match="organised point clouds"):
        read(tmp_path, CONFIG)


def test_colour_in_three_numbers_is_no_packed_colour(tmp_path):
    points = camera_points(walk(1)[0])
    write_pcd(tmp_path / "a.pcd", points)
    header, body = (tmp_path / "a.pcd").read_bytes().split(b"DATA binary\n")
    for old, new in (
        (b"x y z", b"x y z rgb"),
        (b"4 4 4", b"4 4 4 4"),
        (b"F F F", b"F F F F"),
        (b"1 1 1\n", b"1 1 1 3\n"),
    ):
        header = header.replace(old, new)
    rows = np.concatenate([np.frombuffer(body, "<f4").reshape(-1, 3), np.zeros((points[..., 0].size, 3), "<f4")], 1)
    (tmp_path / "a.pcd").write_bytes(header + b"DATA binary\n" + rows.astype("<f4").tobytes())
    capture = frames_of(tmp_path)
    assert not capture.has_color
    assert capture.frames[0].depth().any()


def test_a_header_with_impossible_promises(tmp_path):
    write_pcd_folder(tmp_path, walk(3))
    path = tmp_path / "cloud001.pcd"
    path.write_bytes(path.read_bytes().replace(b"WIDTH 96", b"WIDTH 9600000"))
    assert "impossible number of points" in reason(frames_of(tmp_path), "cloud001")


# ---------------------------------------------------------------- everything


@EVERY
def test_random_damage_never_ends_in_anything_but_a_message(name, tmp_path):
    """Cut or scramble each kind of file of each layout: a RealsimError or a capture without the frame, never else."""
    original = tmp_path / "original"
    WRITERS[name](original, walk(4))
    rng = np.random.default_rng(1)
    kinds = {p.suffix + p.stem[:6] * (p.suffix in (".txt", ".json", ".log", ".yaml")): p for p in original.rglob("*.*")}
    for kind, path in sorted(kinds.items()):
        if path.is_dir():
            continue
        for trial in range(3):
            work = tmp_path / f"{trial}{kind.replace('.', '_')}"
            shutil.copytree(original, work)
            victim = work / path.relative_to(original)
            data = bytearray(victim.read_bytes())
            for at in rng.integers(0, len(data), 20):
                data[at] = rng.integers(0, 256)
            victim.write_bytes(bytes(data[: rng.integers(1, len(data))]) if trial else bytes(data))
            with contextlib.suppress(RealsimError):
                for frame in frames_of(work).frames:
                    depth = frame.depth()
                    assert np.isfinite(depth).all()
                    assert depth.shape == (CAMERA.height, CAMERA.width)


BROKEN = {
    "dangling": lambda path: path.symlink_to("/nowhere"),
    "loop": lambda path: path.symlink_to(path.name),
    "pipe": lambda path: os.mkfifo(path),
    "folder": lambda path: path.mkdir(),
}


@pytest.mark.parametrize("kind", list(BROKEN))
@pytest.mark.parametrize(("layout", "name"), [("plain", "depth/000002.png"), ("pcd", "cloud002.pcd")])
def test_what_is_no_file_is_a_frame_that_was_dropped(layout, name, kind, tmp_path):
    WRITERS[layout](tmp_path, walk(6))
    (tmp_path / name).unlink()
    BROKEN[kind](tmp_path / name)
    assert reason(frames_of(tmp_path), (tmp_path / name).stem)


def test_a_frame_without_confidence_is_said(tmp_path):
    WRITERS["scannerapp"](tmp_path, walk(6))
    (tmp_path / "conf_00003.png").unlink()
    assert any("1 of 6 frames have no confidence" in w for w in frames_of(tmp_path).warnings)


def test_a_time_stamp_that_goes_back_is_said(tmp_path):
    WRITERS["stray"](tmp_path, walk(6))
    assert not any("do not increase" in w for w in frames_of(tmp_path).warnings)
    table = tmp_path / "odometry.csv"
    header, *rows = table.read_text().splitlines()
    stamps, rest = zip(*(row.split(",", 1) for row in rows), strict=True)
    moved = [f"{'-5.0' if i == 3 else t},{r}" for i, (t, r) in enumerate(zip(stamps, rest, strict=True))]
    table.write_text("\n".join([header, *moved]) + "\n")
    assert any("1 of 6 time stamps do not increase" in w for w in frames_of(tmp_path).warnings)


def test_a_bag_that_is_a_link_to_itself(tmp_path):
    (tmp_path / "a.bag").symlink_to("a.bag")
    with pytest.raises(RealsimError, match="cannot be read"):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a.ply", "a.r3d", "a.zip"])
def test_a_pipe_is_not_waited_for(tmp_path, name):
    """Nobody writes into it: opening it to look at its first bytes never ended."""
    os.mkfifo(tmp_path / name)
    for path in (tmp_path, tmp_path / name):
        done = []

        def attempt(path=path, done=done):
            with pytest.raises(RealsimError):
                read(path, CONFIG)
            done.append(path)

        thread = threading.Thread(target=attempt, daemon=True)
        thread.start()
        thread.join(30)
        assert done == [path]


def test_an_error_of_the_disk_is_said(tmp_path):
    write_pcd_folder(tmp_path, walk(4))
    (tmp_path / "cloud001.pcd").unlink()
    (tmp_path / "cloud001.pcd").symlink_to("/proc/self/mem")
    assert "cannot be read" in reason(frames_of(tmp_path), "cloud001")
