"""Depth frames of a recording stand in the case beside their run, and say of the camera what those of the robot do."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from realsim.cli.command_line import main
from realsim.core.errors import GapError
from realsim.gap.case.case import load_case
from realsim.gap.checks.camera.recorded import depth_camera, read_frames
from realsim.gap.recordings import Window, load_target, propose, read, write_case
from tests.truths.crossings import Truth, focal, make_case

from . import writers
from .robots import ARM, Log, save

pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed: pip install -e '.[dev]'")
IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data\n{writers.HEADER}"
)
INFO = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
    f"float64[9] r\nfloat64[12] p\n{writers.HEADER}"
)
ODOMETRY = (
    f"std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n{writers.HEADER}"
    f"{writers.SEPARATOR}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
    f"{writers.SEPARATOR}MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    f"{writers.SEPARATOR}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{writers.SEPARATOR}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
FEET = f"std_msgs/Header header\nstring[] names\nfloat64[] contact\n{writers.HEADER}"
WAIT = 0.02
"""s from a picture's stamp to its reception."""


def _stamped(t: float, frame: str = "") -> dict[str, Any]:
    return {"stamp": writers.stamp(t), "frame_id": frame}


def _frame(topic: str, t: float, image: np.ndarray, fx: float) -> list[Any]:
    """A picture and its camera_info."""
    h, w = image.shape
    kind = "32FC1" if image.dtype == np.float32 else "16UC1"
    head = _stamped(t, "head_optical_frame")
    K = [fx, 0.0, (w - 1) / 2, 0.0, fx, (h - 1) / 2, 0.0, 0.0, 1.0]
    picture = {
        "header": head, "height": h, "width": w, "encoding": kind, "is_bigendian": 0, "step": image.strides[0],
        "data": image.tobytes(),
    }  # fmt: skip
    info = {
        "header": head, "height": h, "width": w, "distortion_model": "plumb_bob", "d": [0.0] * 5, "k": K,
        "r": list(np.eye(3).ravel()), "p": [0.0] * 12,
    }  # fmt: skip
    return [
        (f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", INFO, t + WAIT, info),
        (f"{topic}/image_raw", "sensor_msgs/msg/Image", IMAGE, t + WAIT, picture),
    ]


def _walk(run: Path, names: list[str], feet: list[str], fx: float) -> list[Any]:
    """The messages of a crossing."""
    data = np.load(run)
    found: list[Any] = []
    for i, seconds in enumerate(data["time"]):
        t = writers.EPOCH + float(seconds)
        head = _stamped(t)
        none: list[float] = []
        state = {"header": head, "name": names, "position": list(data["joint_pos"][i]), "velocity": none,
                 "effort": list(data["joint_torque"][i])}  # fmt: skip
        sent = {"header": head, "name": names, "position": list(data["command"][i]), "velocity": none, "effort": none}
        w, x, y, z = data["base_quat"][i]
        place = dict(zip("xyz", data["base_pos"][i], strict=True))
        pose = {"position": place, "orientation": {"x": x, "y": y, "z": z, "w": w}}
        found += [
            ("/joint_states", "sensor_msgs/msg/JointState", writers.JOINT_STATE, t + 0.002, state),
            ("/joint_command", "sensor_msgs/msg/JointState", writers.JOINT_STATE, t + 0.002, sent),
            ("/odom", "nav_msgs/msg/Odometry", ODOMETRY, t + 0.002, {
                "header": head, "child_frame_id": "base", "pose": {"pose": pose, "covariance": [0.0] * 36}}),
            ("/feet", "my_pkg/msg/Feet", FEET, t + 0.002, {
                "header": head, "names": feet, "contact": list(data["contact"][i])}),
        ]  # fmt: skip
    for seconds, image in zip(data["depth_time"], data["depth"], strict=True):
        found += _frame("/head/depth", writers.EPOCH + float(seconds), image, fx)
    return sorted(found, key=lambda m: m[3])


def test_a_walk_with_depth_is_read_from_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From MCAP with depth, base pose, feet and joints, by the command, without hand work."""
    made = make_case(tmp_path, Truth(), crossings=1, depth=True, cycles=1)
    case = load_case(made)
    said = json.loads((made / "log.json").read_text())
    bags = tmp_path / "bags"
    bags.mkdir()
    for run in sorted((made / "runs").glob("*.npz")):
        messages = _walk(run, said["joint_names"], said["contact_bodies"], focal(case.model))
        writers.mcap_ros2(bags / f"{run.stem}.mcap", messages)
    out = tmp_path / "again"
    assert main(["log", str(bags), "--model", str(made / "model.xml"), "--out", str(out)]) == 0
    assert "seen by the model's camera head" in capsys.readouterr().out
    again = load_case(out)
    lens = depth_camera(again)
    assert lens is not None
    assert lens.noise is None
    frames, _ = read_frames(again, lens, 400, 10_000)
    for ours, run in zip(frames, sorted((made / "runs").glob("*.npz")), strict=True):
        data = np.load(run)
        inside = (data["depth_time"] >= 0) & (data["depth_time"] <= data["time"][-1])
        np.testing.assert_allclose(ours.time, data["depth_time"][inside], atol=1e-5)
        flat = data["depth"][inside].reshape(inside.sum(), -1)
        np.testing.assert_allclose(ours.depth, np.where(flat <= lens.far, flat, 0.0), atol=1e-6)


def _arm_bag(path: Path, arm: Log, *, topics: tuple[str, ...] = ("/head/depth",), infos: bool = True) -> Path:
    messages = writers.joint_states(arm, ["shoulder_joint", "elbow_joint"]) + writers.float_commands(arm)
    for k, t in enumerate(np.arange(0.0, arm.time[-1], 0.1)):
        image = np.full((12, 16), 1000 + k, np.uint16)
        image[0, 0] = 0
        for topic in topics:
            messages += [m for m in _frame(topic, writers.EPOCH + t, image, 20.0) if infos or "info" not in m[0]]
    return writers.mcap_ros2(path, sorted(messages, key=lambda m: m[3]))


def _model(folder: Path, *names: str) -> Path:
    cameras = "".join(f'<camera name="{n}" pos="0 0 0.1"/>' for n in names)
    return save(folder, ARM.replace('<body name="upper" pos="0 0 1">', f'<body name="upper" pos="0 0 1">{cameras}'))


def test_frames_in_mm_are_written_as_they_are(arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed: pip install -e '.[recon]'")
    target = load_target(_model(tmp_path, "head"))
    proposal = propose(read(_arm_bag(tmp_path / "run.mcap", arm)), target)
    said = write_case(proposal, target, tmp_path / "case")
    case = load_case(tmp_path / "case")
    lens = depth_camera(case)
    assert lens is not None
    (frames,), _ = read_frames(case, lens, 100, 1000)
    np.testing.assert_allclose(frames.depth[:, -1], 1e-3 * (1000 + np.rint(frames.time / 0.1)), atol=1e-9)
    assert (frames.depth[:, 0] == 0).all()
    assert any("noise of head is not known" in s for s in said)
    assert (lens.fx, lens.cx) == (20.0, 7.5)


def test_a_part_of_a_recording_has_its_own_frames(arm: Log, tmp_path: Path) -> None:
    target = load_target(_model(tmp_path, "head"))
    recordings = read(_arm_bag(tmp_path / "run.mcap", arm), Window(1.0, 1.5))
    write_case(propose(recordings, target), target, tmp_path / "case")
    case = load_case(tmp_path / "case")
    lens = depth_camera(case)
    assert lens is not None
    (frames,), _ = read_frames(case, lens, 100, 1000)
    assert len(frames.time) == pytest.approx(15, abs=1)
    assert frames.time[0] >= 0
    assert frames.time[-1] <= case.runs[0].time[-1]
    first = float(recordings[0].streams[0].clocks["receive"][0]) - writers.EPOCH
    np.testing.assert_allclose(frames.depth[:, -1], 1 + 0.01 * (frames.time + first), atol=2e-3)


@pytest.mark.parametrize(
    ("names", "topics", "said"),
    [
        ((), ("/head/depth",), "the model has no camera"),
        (("left", "right"), ("/head/depth",), "--camera NAME"),
        (("head",), ("/head/depth", "/tail/depth"), "several depth cameras"),
    ],
)
def test_what_cannot_be_told_is_asked(
    names: tuple[str, ...], topics: tuple[str, ...], said: str, arm: Log, tmp_path: Path
) -> None:
    target = load_target(_model(tmp_path, *names))
    recordings = read(_arm_bag(tmp_path / "run.mcap", arm, topics=topics))
    proposal = propose(recordings, target)
    assert proposal.depth is None
    assert any(said in m for m in proposal.missing)
    write_case(proposal, target, tmp_path / "case")
    assert depth_camera(load_case(tmp_path / "case")) is None
    if names:
        chosen = propose(recordings, target, camera=f"{names[0]}={topics[-1]}/image_raw").depth
        assert chosen is not None
        assert (chosen.camera, chosen.topic) == (names[0], f"{topics[-1]}/image_raw")


@pytest.mark.parametrize("camera", ["haed", "head=/nowhere"])
def test_a_camera_that_is_not_there_is_refused(camera: str, arm: Log, tmp_path: Path) -> None:
    target = load_target(_model(tmp_path, "head"))
    recordings = read(_arm_bag(tmp_path / "run.mcap", arm))
    with pytest.raises(GapError, match=r"no camera 'haed'|no depth frames on '/nowhere'"):
        propose(recordings, target, camera=camera)


def test_depth_without_camera_info_is_listed(arm: Log, tmp_path: Path) -> None:
    target = load_target(_model(tmp_path, "head"))
    (recording,) = read(_arm_bag(tmp_path / "run.mcap", arm, infos=False))
    assert "without camera_info" in recording.skipped["/head/depth/image_raw"]
    assert propose([recording], target).depth is None


def test_a_camera_info_that_cannot_be_read_is_listed_with_the_reason(arm: Log, tmp_path: Path) -> None:
    messages = writers.joint_states(arm, ["shoulder_joint", "elbow_joint"]) + writers.float_commands(arm)
    for t in np.arange(0.0, arm.time[-1], 0.1):
        info, picture = _frame("/head/depth", writers.EPOCH + t, np.full((12, 16), 1000, np.uint16), 20.0)
        info[-1]["k"] = [0.0] * 9
        messages += [info, picture]
    (recording,) = read(writers.mcap_ros2(tmp_path / "run.mcap", sorted(messages, key=lambda m: m[3])))
    assert "cannot be decoded" in recording.skipped["/head/depth/camera_info"]
    assert "without camera_info" in recording.skipped["/head/depth/image_raw"]


@pytest.mark.parametrize("version", [1, 2])
def test_bags_of_both_versions_hold_frames(version: int, arm: Log, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install -e '.[logs]'")
    pytest.importorskip("cv2", reason="OpenCV is not installed: pip install -e '.[recon]'")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)

    def frames(send: Callable[[str, Any, float], None]) -> None:
        t_ = store.types
        roi = t_["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        for k, t in enumerate(np.arange(0.0, 4.0, 0.1)):
            when = t_["builtin_interfaces/msg/Time"](**writers.stamp(writers.EPOCH + t))
            head = t_["std_msgs/msg/Header"](stamp=when, frame_id="head", **({"seq": k} if version == 1 else {}))
            names = "DKRP" if version == 1 else "dkrp"
            K = np.array([20.0, 0, 7.5, 0, 20, 5.5, 0, 0, 1])
            arrays = dict(zip(names, (np.zeros(5), K, np.eye(3).ravel(), np.zeros(12)), strict=True))
            info = t_["sensor_msgs/msg/CameraInfo"](
                header=head, height=12, width=16, distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi,
                **arrays,
            )  # fmt: skip
            depth = np.full((12, 16), 1000 + k, np.uint16).view(np.uint8).ravel()
            color = np.zeros(12 * 16 * 3, np.uint8)
            send("/head/depth/camera_info", info, t + 0.01)
            image = t_["sensor_msgs/msg/Image"]
            send("/head/depth/image_raw", image(head, 12, 16, "16UC1", 0, 32, depth), t + 0.01)
            send("/head/color/image_raw", image(head, 12, 16, "rgb8", 0, 48, color), t + 0.01)

    path = tmp_path / ("run.bag" if version == 1 else "run")
    writers.bag(path, arm, ["shoulder_joint", "elbow_joint"], version, more=frames)
    target = load_target(_model(tmp_path, "head"))
    proposal = propose(read(path), target)
    assert proposal.depth is not None
    assert "/head/color/image_raw" in proposal.recordings[0].skipped
    write_case(proposal, target, tmp_path / "case")
    case = load_case(tmp_path / "case")
    lens = depth_camera(case)
    assert lens is not None
    (found,), _ = read_frames(case, lens, 100, 1000)
    np.testing.assert_allclose(found.depth[:, -1], 1e-3 * (1000 + np.rint(found.time / 0.1)), atol=1e-9)


def test_a_frame_of_another_size_is_left_out(arm: Log, tmp_path: Path) -> None:
    messages = writers.joint_states(arm, ["shoulder_joint", "elbow_joint"]) + writers.float_commands(arm)
    for k, t in enumerate(np.arange(0.0, arm.time[-1], 0.1)):
        shape = (6, 8) if k == 7 else (12, 16)
        frame = _frame("/head/depth", writers.EPOCH + t, np.full(shape, 1.5, np.float32), 20.0)
        messages += frame if k != 7 else frame[1:]
    path = writers.mcap_ros2(tmp_path / "run.mcap", sorted(messages, key=lambda m: m[3]))
    target = load_target(_model(tmp_path, "head"))
    said = write_case(propose(read(path), target), target, tmp_path / "case")
    assert any("1 depth frames cannot be read: of another size than camera_info says, (6, 8)" in s for s in said)
    lens = depth_camera(load_case(tmp_path / "case"))
    assert lens is not None
    (frames,), _ = read_frames(load_case(tmp_path / "case"), lens, 100, 1000)
    assert (frames.depth == 1.5).all()
