"""Damaged and unusual captures with the right answer beside each, and others of the same kinds made here."""

import json
import struct

import numpy as np
import pytest

from realsim.capture import CaptureConfig, inspect, read
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.files import parse_yaml

from .scene import CAMERA, walk
from .test_layouts import CONFIG, frames_of
from .writers import write_image, write_nerfstudio, write_plain, write_scannerapp, write_sevenscenes, write_tum

ERRORS = {
    "broken/tum_times_nan": ("depth.txt", "line 2: nan"),
    "broken/tum_times_zero": ("rgb.txt", "line 3: 0"),
    "broken/yaml_alias_bomb": ("intrinsics.yaml", "aliases"),
    "broken/stl_nan_vertex": ("terrain.stl", "43 vertices"),
    "scenes/r01_depth_jet": ("depth", "record depth as 16 bit"),
    "scenes/r02_depth_8bit": ("depth", "record depth as 16 bit"),
    "scenes/r06_intrinsics_1280_nosize": ("camera_intrinsic.json", "images of about 1272x738"),
    "scenes/r06b_intrinsics_1280_size": ("camera_intrinsic.json", "1280x720"),
}
DROPPED = {
    "scannerapp_pose_1e9": ("00003", "1e+09"),
    "arkitscenes_pose_1e308": ("41069021_3000.200", "away from the others"),
    "record3d_true_in_pose": ("000002", "no number"),
    "pcd_one_byte_more": ("cloud001", "found 110593"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_a_case_is_refused_with_its_reason(case, shared):
    name, reason = ERRORS[case]
    with pytest.raises(RealsimError) as caught:
        inspect(shared(f"cases/{case}"), CONFIG)
    assert str(caught.value.file).endswith(name)
    assert reason in caught.value.render()


@pytest.mark.parametrize("case", DROPPED)
def test_a_case_loses_one_frame_by_name(case, shared):
    name, reason = DROPPED[case]
    found = inspect(shared(f"cases/broken/{case}"), CONFIG)
    assert list(found.frames["dropped"]) == [name]
    assert reason in found.frames["dropped"][name]
    assert any(name in line for line in found.wrong)


@pytest.mark.parametrize("case", ["r04_exif_rotated", "r07_depth_half_res", "r08_unpadded"])
def test_a_case_without_a_fault(case, shared):
    found = inspect(shared(f"cases/scenes/{case}"), CONFIG)
    assert (found.frames["used"], found.wrong) == (4, ())


@pytest.mark.parametrize(
    "at", [np.full(3, 1e4), np.array([0, 0, -1e200]), np.array([300.0, 0, 0]), np.array([4.0, 1, 1])]
)
def test_a_camera_that_flew_off_is_left_out_by_name(at, tmp_path):
    views = walk(8)
    write_sevenscenes(tmp_path, views)
    T = views[5].T_world_camera.copy()
    T[:3, 3] = at
    np.savetxt(tmp_path / "frame-000005.pose.txt", T)
    assert [d.name for d in frames_of(tmp_path).dropped] == ["frame-000005"]


def test_far_from_the_origin_together_is_no_fault(tmp_path):
    views = walk(8)
    write_sevenscenes(tmp_path, views)
    for i, view in enumerate(views):
        T = view.T_world_camera.copy()
        T[:3, 3] += [484213.37, 5457120.61, 312.48]
        np.savetxt(tmp_path / f"frame-{i:06d}.pose.txt", T, fmt="%.9f")
    assert frames_of(tmp_path).dropped == ()


@pytest.mark.parametrize("bad", [None, True, "north", [1.0], {"x": 1}])
def test_something_else_in_a_pose_costs_its_frame(bad, tmp_path):
    write_scannerapp(tmp_path, walk(6))
    path = tmp_path / "frame_00002.json"
    data = json.loads(path.read_text())
    data["cameraPoseARFrame"][3] = bad
    path.write_text(json.dumps(data))
    assert [d.name for d in frames_of(tmp_path).dropped] == ["00002"]


def test_one_image_without_a_time_is_left_out(tmp_path):
    write_tum(tmp_path, walk(8))
    lines = (tmp_path / "rgb.txt").read_text().splitlines()
    lines[3] = "inf " + lines[3].split()[1]
    (tmp_path / "rgb.txt").write_text("\n".join(lines))
    capture = frames_of(tmp_path)
    assert len(capture) == 7
    assert any("1 images without a time" in w and "line 4" in w for w in capture.warnings)


def test_clocks_of_colour_and_depth_that_do_not_overlap(tmp_path):
    write_tum(tmp_path, walk(4))
    lines = [line.split() for line in (tmp_path / "depth.txt").read_text().splitlines() if line[0] != "#"]
    (tmp_path / "depth.txt").write_text("\n".join(f"{float(t) - 1e9} {name}" for t, name in lines))
    with pytest.raises(CaptureError, match="colour and depth do not overlap"):
        read(tmp_path, CONFIG)


@pytest.mark.parametrize(
    "text",
    ["a: &a [*a]", "a: &a {b: &b [*a, *b]}", "\n".join(f"k{i}: &k{i} [{f'*k{i - 1},' * 30}]" for i in range(1, 9))],
)
def test_yaml_that_expands_without_end(text, tmp_path):
    with pytest.raises(RealsimError, match="YAML"):
        parse_yaml(text.replace("*k0", "0"), tmp_path / "a.yaml")


def test_yaml_with_a_usual_alias(tmp_path):
    assert parse_yaml("a: &a [1, 2]\nb: *a\n", tmp_path / "a.yaml") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    ("size", "how"),
    [((640, 480), None), ((1280, 720), "refused"), ((1920, 1080), "refused"), ((106, 76), None), ((128, 96), "warned")],
)
def test_intrinsics_of_another_size_without_their_size(size, how, tmp_path):
    write_plain(tmp_path, walk(4))
    (tmp_path / "intrinsics.yaml").unlink()
    # As of images `size`, where those in the folder are 640x480, in the proportion of CAMERA.
    cx, cy = CAMERA.width * size[0] / 640 / 2, CAMERA.height * size[1] / 480 / 2
    if max(size) < 640:
        cx, cy = size[0] / 2, size[1] / 2
    (tmp_path / "intrinsics.txt").write_text(f"88 87 {cx} {cy}")
    if how == "refused":
        with pytest.raises(CaptureError, match=r"another size|principal point"):
            read(tmp_path, CONFIG)
        return
    said = [w for w in frames_of(tmp_path).warnings if "principal point" in w]
    assert bool(said) == (how == "warned")


def test_a_cropped_image_with_its_size_is_warned_about_only(tmp_path):
    write_plain(tmp_path, walk(4))
    (tmp_path / "intrinsics.yaml").unlink()
    (tmp_path / "intrinsics.txt").write_text("88 87 74 37 96 72")
    assert any("principal point" in w for w in frames_of(tmp_path).warnings)


def test_a_capture_that_changes_resolution_names_the_frames(tmp_path):
    views = walk(8)
    write_plain(tmp_path, views)
    for i in (6, 7):
        for kind in ("rgb", "depth"):
            path = next((tmp_path / kind).glob(f"*{i:06d}*"))
            write_image(path, np.zeros((36, 48, 3), np.uint8) if kind == "rgb" else np.full((36, 48), 900, np.uint16))
    dropped = frames_of(tmp_path).dropped
    assert len(dropped) == 2
    assert all("another size" in d.reason for d in dropped)


def test_an_stl_whose_normals_contradict_a_triangle(tmp_path):
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), [0.0], indexing="ij"), -1)[:, :, 0] / 2
    corners = [[grid[i, j], grid[i + 1, j], grid[i + 1, j + 1]] for i in range(4) for j in range(4)] + [
        [grid[i, j], grid[i + 1, j + 1], grid[i, j + 1]] for i in range(4) for j in range(4)
    ]
    table = [np.concatenate([[[0, 0, 1.0]], triangle]) for triangle in corners]

    def write(name: str) -> None:
        rows = b"".join(np.asarray(t, "<f4").tobytes() + b"\0\0" for t in table)
        (tmp_path / name).write_bytes(b"\0" * 80 + struct.pack("<I", len(table)) + rows)

    write("good.stl")
    table[7][2, 2] = 0.3
    write("bad.stl")
    assert read(tmp_path / "good.stl", CaptureConfig()).warnings == ()
    assert any("1 of 32 triangles contradict" in w for w in read(tmp_path / "bad.stl", CaptureConfig()).warnings)


def test_the_camera_of_a_bundlefusion_export(tmp_path):
    views, K = walk(4), np.eye(4)
    write_sevenscenes(tmp_path, views)
    K[:3, :3] = CAMERA.K
    (tmp_path / "camera-intrinsics.txt").unlink()
    lines = {
        "m_versionNumber": "4",
        "m_colorWidth": CAMERA.width,
        "m_colorHeight": CAMERA.height,
        "m_depthShift": 1000,
        "m_calibrationColorIntrinsic": " ".join(map(repr, K.ravel().tolist())),
    }
    (tmp_path / "info.txt").write_text("".join(f"{name} = {value}\n" for name, value in lines.items()))
    frame = frames_of(tmp_path).frames[1]
    assert frame.intrinsics == CAMERA
    np.testing.assert_allclose(frame.depth()[views[1].depth > 0], views[1].depth[views[1].depth > 0], atol=6e-4)


def test_images_without_a_suffix_are_png(tmp_path):
    write_nerfstudio(tmp_path, walk(4))
    path = tmp_path / "transforms.json"
    path.write_text(path.read_text().replace('.png", "depth_file_path"', '", "depth_file_path"'))
    assert len(frames_of(tmp_path)) == 4


def test_millimetres_shifted_by_three_bits_are_named(tmp_path):
    views = walk(4)
    write_plain(tmp_path, views)
    for i, view in enumerate(views):
        write_image(tmp_path / f"depth/{i:06d}.png", np.rint(1000 * view.depth).astype(np.uint16) << 3)
    with pytest.raises(CaptureError) as caught:
        frames_of(tmp_path)
    assert "SUN3D" in caught.value.render()
    assert "--depth-unit 0.000125" in caught.value.render()
