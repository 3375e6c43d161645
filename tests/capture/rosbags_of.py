"""Bags with a depth camera, written by the `rosbags` package: the exact walk, by ROS's conventions."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from realsim.core.geometry import R_to_quat, invert_T, make_T
from realsim.core.types import Intrinsics

from .scene import CAMERA, View

T_BASE_DEPTH = make_T(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0.2, 0.0, 0.1])
"""The camera on its robot: its optical axis along x."""
FINE = [cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
"""The walk's texture is noise, which usual JPEG would smear."""


def write_bag(
    path: Path,
    views: Sequence[View],
    *,
    storage: str = "sqlite",
    depth: str = "16UC1",
    color: str = "rgb8",
    T_depth_color: np.ndarray | None = None,
    tf: bool = True,
    odometry: bool = False,
    cameras: Sequence[str] = ("/camera",),
    infos: bool = True,
    clock: Any = lambda t: t,
    definitions: bool = True,
    intrinsics: Intrinsics = CAMERA,
) -> Path:
    """Write a ROS 2 bag (folder) or, with storage `ros1`, a .bag; a single .mcap file with storage `mcap_file`."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    one = storage == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    if one:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    t_ = store.types
    pack = store.serialize_ros1 if one else store.serialize_cdr
    plugin = StoragePlugin.SQLITE3 if storage == "sqlite" else StoragePlugin.MCAP
    folder = path.with_suffix(".folder") if storage == "mcap_file" else path
    writer = Writer1(folder) if one else Writer2(folder, version=8, storage_plugin=plugin)

    def header(frame: str, time: float) -> Any:
        stamp = t_["builtin_interfaces/msg/Time"](int(time), round((time - int(time)) * 1e9))
        return t_["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **({"seq": 0} if one else {}))

    def transform(parent: str, child: str, T: np.ndarray, time: float) -> Any:
        w, x, y, z = R_to_quat(T[:3, :3])
        v = t_["geometry_msgs/msg/Vector3"](*map(float, T[:3, 3]))
        q = t_["geometry_msgs/msg/Quaternion"](x, y, z, w)
        return t_["geometry_msgs/msg/TransformStamped"](
            header(parent, time), child, t_["geometry_msgs/msg/Transform"](v, q)
        )

    def info(frame: str, camera: Intrinsics, time: float) -> Any:
        roi = t_["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        K, P = camera.K.ravel(), np.column_stack([camera.K, np.zeros(3)]).ravel()
        names = ("D", "K", "R", "P") if one else ("d", "k", "r", "p")
        arrays = dict(zip(names, (np.zeros(5), K, np.eye(3).ravel(), P), strict=True))
        return t_["sensor_msgs/msg/CameraInfo"](
            header=header(frame, time), height=camera.height, width=camera.width, distortion_model="plumb_bob",
            binning_x=0, binning_y=0, roi=roi, **arrays,
        )  # fmt: skip

    def picture(frame: str, time: float, kind: str, data: np.ndarray) -> tuple[str, Any]:
        head = header(frame, time)
        if kind in ("jpeg", "png"):
            done, packed = cv2.imencode("." + kind, data[..., ::-1], FINE if kind == "jpeg" else [])
            assert done
            return "", t_["sensor_msgs/msg/CompressedImage"](head, kind, packed.ravel())
        if kind == "compressedDepth":
            done, packed = cv2.imencode(".png", np.rint(data * 1000).astype(np.uint16))
            assert done
            text = "16UC1; compressedDepth"
            return "/compressedDepth", t_["sensor_msgs/msg/CompressedImage"](
                head, text, np.concatenate([np.zeros(12, np.uint8), packed.ravel()])
            )
        if kind == "16UC1":
            data = np.rint(data * 1000).astype(np.uint16)
        elif kind == "32FC1":
            data = np.where(data > 0, data, np.nan).astype(np.float32)
        elif kind == "bgr8":
            data = np.ascontiguousarray(data[..., ::-1])
        rows = np.ascontiguousarray(data).view(np.uint8).reshape(data.shape[0], -1)
        rows = np.hstack([rows, np.zeros((len(rows), 8), np.uint8)])  # padding, as drivers may add
        return "", t_["sensor_msgs/msg/Image"](head, data.shape[0], data.shape[1], kind, 0, rows.shape[1], rows.ravel())

    with writer as out:
        connections: dict[tuple[str, str], Any] = {}

        def send(topic: str, message: Any, time: float) -> None:
            kind = message.__msgtype__
            if (topic, kind) not in connections:
                connections[topic, kind] = out.add_connection(topic, kind, typestore=store)
            out.write(connections[topic, kind], round(time * 1e9), pack(message, kind))

        tf_type = t_["tf2_msgs/msg/TFMessage"]
        for view in views:
            stamp = clock(view.time)
            for camera in cameras:
                near = camera.strip("/")
                of_color = f"{near}_color_optical_frame" if T_depth_color is not None else f"{near}_optical_frame"
                of_depth = f"{near}_optical_frame"
                if tf and view is views[0]:
                    links = [transform("base_link", of_depth, T_BASE_DEPTH, stamp)]
                    if T_depth_color is not None:
                        links.append(transform(of_depth, of_color, T_depth_color, stamp))
                    send("/tf_static", tf_type(links), view.time)
                T = view.T_world_camera @ invert_T(T_BASE_DEPTH)
                if tf and not odometry:
                    send("/tf", tf_type([transform("odom", "base_link", T, stamp)]), view.time)
                if odometry:
                    moving = transform("odom", "base_link", T, stamp)
                    t, q = moving.transform.translation, moving.transform.rotation
                    pose = t_["geometry_msgs/msg/Pose"](t_["geometry_msgs/msg/Point"](t.x, t.y, t.z), q)
                    zero = t_["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
                    none = np.zeros(36)
                    send("/odom", t_["nav_msgs/msg/Odometry"](
                        header("odom", stamp), "base_link", t_["geometry_msgs/msg/PoseWithCovariance"](pose, none),
                        t_["geometry_msgs/msg/TwistWithCovariance"](t_["geometry_msgs/msg/Twist"](zero, zero), none),
                    ), view.time)  # fmt: skip
                if infos:
                    send(f"{camera}/depth/camera_info", info(of_depth, intrinsics, stamp), view.time)
                    send(f"{camera}/color/camera_info", info(of_color, intrinsics, stamp), view.time)
                end, message = picture(of_depth, stamp, depth, view.depth)
                send(f"{camera}/depth/image_rect_raw{end}", message, view.time + 0.002)
                if color:
                    end, message = picture(of_color, clock(view.time + 0.004), color, view.color)
                    send(f"{camera}/color/image_raw{end}", message, view.time + 0.006)
    if storage == "mcap_file":
        shutil.move(next(folder.glob("*.mcap")), path)
        shutil.rmtree(folder)
    if storage == "sqlite" and not definitions:
        import sqlite3

        with sqlite3.connect(next(path.glob("*.db3"))) as database:
            database.execute("DELETE FROM message_definitions")
    return path
