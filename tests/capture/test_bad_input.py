"""Damaged single frames are dropped and named, the rest goes on; what is wrong as a whole is an error that helps."""

import contextlib
import json
import os
import re
import shutil
import threading
from dataclasses import replace

import numpy as np
import pytest

from realsim.capture import CaptureConfig, read
from realsim.core.errors import CaptureError, PoseError, RealsimError

from .damage import cut, reason
from .scene import CAMERA, walk
from .test_layouts import CONFIG, frames_of
from .writers import (
    WRITERS,
    camera_points,
    write_pcd,
    write_pcd_folder,
    write_plain,
    write_tum,
)

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
        for config in (CaptureConfig(layout=name), CONFIG):
            with pytest.raises(CaptureError, match="no intrinsics") as caught:
                read(folder, config)
        named = re.search(r"into (\S+\.(?:txt|json))", caught.value.hint or "")
        if named:  # what the hint says to write is what the layout reads
            camera = {"fx": 88, "fy": 87, "cx": 46.5, "cy": 37, "width": 96, "height": 72}
            text = json.dumps(camera) if named[1].endswith("json") else " ".join(map(str, camera.values()))
            (folder / named[1]).write_text(text)
            assert read(folder, CONFIG).frames


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "no camera parameters"),
        ('{"fx": "wide"}', "no camera parameters"),
        ('{"fx": "wide", "fy": 1, "cx": 1, "cy": 1}', "not a number"),
        ('{"K": [1, 2, 3]}', "nine finite numbers"),
        ('{"K": [NaN, 0, 46, 0, 87, 37, 0, 0, 1]}', "nine finite numbers"),
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
        ('{"fx": 88, "fy": 87, "cx": 46, "cy": 37, "width": 96.5, "height": 75}', "not a number of pixels"),
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


def test_a_camera_file_that_leads_nowhere_is_not_passed_over(tmp_path):
    write_plain(tmp_path, walk(3))
    (tmp_path / "intrinsics.yaml").unlink()
    (tmp_path / "odometry.log").touch()  # Open3D's folder: without a camera, its default is taken
    (tmp_path / "camera_intrinsic.json").symlink_to("gone.json")
    with pytest.raises(RealsimError, match="cannot be read") as caught:
        read(tmp_path, CONFIG)
    assert "camera_intrinsic.json" in str(caught.value.file)


@pytest.mark.parametrize("size", ["nan nan", "96 inf", "-96 75"])
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


@pytest.mark.parametrize("name", WRITERS)
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


POSES = {
    "open3d": "trajectory.log",
    "tum": "groundtruth.txt",
    "stray": "odometry.csv",
    "arkitscenes": "lowres_wide.traj",
}


@pytest.mark.parametrize("kind", list(BROKEN))
@pytest.mark.parametrize("layout", list(POSES))
def test_poses_that_are_no_file_are_not_taken_for_none(layout, kind, tmp_path):
    WRITERS[layout](tmp_path, walk(6))
    for path in tmp_path.rglob(POSES[layout]):
        path.unlink()
        BROKEN[kind](path)
    with pytest.raises(PoseError, match=POSES[layout]):
        read(tmp_path, CONFIG)
    assert all(f.T_world_camera is None for f in read(tmp_path, replace(CONFIG, ignore_poses=True)).frames)


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
    assert "not a plain file" in reason(frames_of(tmp_path), "cloud001")
