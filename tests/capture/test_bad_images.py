"""Images and depth that are cut, empty, twice there or in another unit: dropped and named, or an error that helps."""

import shutil

import cv2
import numpy as np
import pytest

from realsim.capture import CaptureConfig, read
from realsim.core.errors import CaptureError

from .damage import cut, reason
from .scene import walk
from .test_layouts import CONFIG, frames_of
from .writers import (
    millimetres,
    write_image,
    write_open3d,
    write_plain,
)

# ---------------------------------------------------------------- images


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
    expected = {"archive": "corrupt array", "eight bits": "coloured for viewing"}.get(kind, "depth of another type")
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
