"""Bags and MCAP with a depth camera: whatever the encoding, the same frames; what is missing or odd is said."""

from pathlib import Path

import numpy as np
import pytest

from realsim.capture import CaptureConfig, inspect, read
from realsim.capture.transforms import Tree
from realsim.core.errors import CaptureError, RealsimError
from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import FrameSet

from .rosbags_of import write_bag
from .scene import walk

CONFIG = CaptureConfig()


def in_chunks(source: Path, path: Path) -> Path:
    """The same messages in chunks of 40 kB, as recorders write them; rosbags makes one chunk of all."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with source.open("rb") as old, path.open("wb") as new:
        writer = Writer(new, chunk_size=40_000)
        writer.start()
        known: dict[int, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            if channel.id not in known:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(known[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return path


def frames(path: Path, config: CaptureConfig = CONFIG) -> FrameSet:
    found = read(path, config)
    assert isinstance(found, FrameSet)
    assert found.layout == "rosbag"
    return found


@pytest.mark.parametrize(
    ("storage", "depth", "color"),
    [
        ("sqlite", "16UC1", "rgb8"),
        ("mcap", "32FC1", "bgr8"),
        ("mcap_file", "compressedDepth", "jpeg"),
        ("ros1", "16UC1", "png"),
    ],
)
def test_every_storage_and_encoding_gives_the_same_frames(tmp_path, storage, depth, color):
    views = walk(6)
    name = {"ros1": "walk.bag", "mcap_file": "walk.mcap"}.get(storage, "walk")
    found = frames(write_bag(tmp_path / name, views, storage=storage, depth=depth, color=color))
    assert len(found) == len(views)
    assert found.up_world == pytest.approx([0, 0, 1])
    for frame, view in zip(found.frames, views, strict=True):
        assert np.abs(frame.depth() - view.depth).max() < 6e-4
        assert frame.T_world_camera == pytest.approx(view.T_world_camera, abs=1e-6)
        difference = np.abs(frame.color().astype(float) - view.color).mean()
        assert difference <= (3 if color == "jpeg" else 0)


def test_a_bag_of_humble_without_definitions_and_with_odometry_alone(tmp_path):
    views = walk(5)
    found = frames(write_bag(tmp_path / "bag", views, odometry=True, definitions=False))
    assert found.frames[3].T_world_camera == pytest.approx(views[3].T_world_camera, abs=1e-6)


def test_without_tf_there_are_no_poses(tmp_path):
    found = frames(write_bag(tmp_path / "bag", walk(4), tf=False))
    assert not found.has_poses
    assert any("poses are found from the frames" in a for a in found.assumptions)


def test_colour_from_another_place_is_brought_to_the_depth_camera(tmp_path):
    """A colour camera turned by half a turn about the optical axis and nothing else: its picture is upside down."""
    views = walk(4)
    turned = [type(v)(v.T_world_camera, v.depth, v.color[::-1, ::-1].copy(), v.time) for v in views]
    T = make_T(exp_so3([0, 0, np.pi]), np.zeros(3))
    found = frames(write_bag(tmp_path / "bag", turned, T_depth_color=T))
    picture, view = found.frames[1].color(), views[1]
    seen = (picture > 0).any(axis=2) & (view.depth > 0)
    assert seen.mean() > 0.8
    u, v = 2 * 46.5 - np.arange(96), 2 * 37.0 - np.arange(72)  # half a turn about the principal point
    inside = seen & ((u >= 0) & (u < 96))[None] & ((v >= 0) & (v < 72))[:, None]
    row, column = np.nonzero(inside)
    want = turned[1].color[v[row].astype(int), u[column].astype(int)]
    assert np.array_equal(picture[row, column], want)
    assert any("resampled" in a for a in found.assumptions)


def test_two_cameras_are_an_error_that_names_them(tmp_path):
    path = write_bag(tmp_path / "bag", walk(3), cameras=("/front", "/rear"))
    with pytest.raises(CaptureError, match="several depth cameras") as error:
        read(path, CONFIG)
    assert "--camera /front or --camera /rear" in str(error.value)
    assert len(frames(path, CaptureConfig(camera="/rear"))) == 3


def test_missing_topics_are_said_with_those_that_are_there(tmp_path):
    with pytest.raises(CaptureError, match="no camera_info") as error:
        read(write_bag(tmp_path / "bag", walk(3), infos=False), CONFIG)
    assert "/camera/color/image_raw (sensor_msgs/msg/Image)" in str(error.value)
    colour_only = [type(v)(v.T_world_camera, v.color, v.color, v.time) for v in walk(3)]
    with pytest.raises(CaptureError, match="no depth images"):
        read(write_bag(tmp_path / "colour", colour_only, depth="rgb8"), CONFIG)


def test_a_file_that_ends_in_the_middle_is_read_as_far_as_it_goes(tmp_path):
    path = in_chunks(write_bag(tmp_path / "whole.mcap", walk(8), storage="mcap_file"), tmp_path / "walk.mcap")
    (tmp_path / "whole.mcap").unlink()
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    found = frames(path)
    assert 0 < len(found) < 8
    assert any("cut off" in w or "damaged" in w for w in found.warnings)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"nothing of the kind" * 10])
@pytest.mark.parametrize("name", ["walk.mcap", "walk.db3", "walk.bag"])
def test_files_that_are_no_bags_are_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RealsimError):
        read(tmp_path / name, CONFIG)


def test_a_clock_that_jumps_is_not_believed(tmp_path):
    path = write_bag(tmp_path / "bag", walk(8), clock=lambda t: t + (3.0 if t > walk(8)[4].time else 0.0))
    found = frames(path)
    assert len(found) == 8
    assert not found.has_poses
    assert any("jumps" in w for w in found.warnings)


def test_inspect_says_what_was_taken(tmp_path):
    text = inspect(write_bag(tmp_path / "bag", walk(5)), CONFIG).render()
    assert "/camera/depth/image_rect_raw" in text
    assert "by tf" in text


def test_a_changed_bag_is_unpacked_anew(tmp_path):
    path = write_bag(tmp_path / "walk.mcap", walk(4), storage="mcap_file")
    assert len(frames(path)) == 4
    path.unlink()
    write_bag(path, walk(6), storage="mcap_file")
    assert len(frames(path)) == 6


def test_transforms_compose_along_the_tree_and_circles_are_refused():
    rng = np.random.default_rng(0)
    links = [make_T(exp_so3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(4)]
    tree = Tree()
    tree.add("world", "base", links[0], 0.0, static=False)
    tree.add("world", "base", links[0], 1.0, static=False)
    for parent, child, T in (("base", "mount", links[1]), ("mount", "left", links[2]), ("mount", "right", links[3])):
        tree.add(parent, child, T, 0.0, static=True)
    assert tree.root("right") == "world"
    assert tree.poses("right", np.array([0.5]), 2.0)[0] == pytest.approx(links[0] @ links[1] @ links[3])
    assert tree.poses("right", np.array([5.0]), 2.0) == [None]
    assert tree.between("left", "right") == pytest.approx(np.linalg.inv(links[2]) @ links[3])
    assert tree.between("world", "right") is None  # a moving link lies between
    tree.add("right", "world", np.eye(4), 0.0, static=True)
    with pytest.raises(CaptureError, match="circle"):
        tree.poses("right", np.array([0.5]), 2.0)
