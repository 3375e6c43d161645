"""Recordings in the formats that robots' tools write, by the formats' own libraries."""

import json
import sqlite3
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .robots import Log

EPOCH = 1_700_000_000.0
SEPARATOR = "=" * 80 + "\n"
HEADER = (
    f"{SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
JOINT_STATE = (
    f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{HEADER}"
)
COMMANDS = (
    "std_msgs/MultiArrayLayout layout\nfloat64[] data\n"
    f"{SEPARATOR}MSG: std_msgs/MultiArrayLayout\nstd_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n"
    f"{SEPARATOR}MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n"
)
POINT = (
    f"{SEPARATOR}MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\nfloat64[] velocities\n"
    "float64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start\n"
    f"{SEPARATOR}MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
)
TRAJECTORY = (
    f"std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points\n{HEADER}{POINT}"
)
CONTROLLER = (
    "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint reference\n"
    f"trajectory_msgs/JointTrajectoryPoint feedback\ntrajectory_msgs/JointTrajectoryPoint error\n{HEADER}{POINT}"
)
STRANGE = "std_msgs/Header header\nmy_pkg/Wheel[2] wheels\n" + f"{SEPARATOR}MSG: my_pkg/Wheel\nfloat32 speed\n{HEADER}"


def stamp(t: float) -> dict[str, int]:
    return {"sec": int(t), "nanosec": round((t - int(t)) * 1e9)}


def header(t: float) -> dict[str, Any]:
    return {"stamp": stamp(t), "frame_id": ""}


def mcap_ros2(path: Path, messages: Sequence[tuple[str, str, str, float, dict[str, Any]]]) -> Path:
    """(topic, type, definition, s received, message) of each message, as `ros2 bag record -s mcap` writes them."""
    library = pytest.importorskip("mcap_ros2.writer", reason="needs mcap-ros2-support: pip install -e '.[dev]'")
    with path.open("wb") as file:
        writer = library.Writer(file, chunk_size=16 * 1024)
        schemas: dict[str, Any] = {}
        for topic, kind, text, t, message in messages:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, text)
            nanos = round(t * 1e9)
            writer.write_message(topic, schemas[kind], message, log_time=nanos, publish_time=nanos)
        writer.finish()
    return path


def mcap_protobuf(path: Path, log: Log, names: Sequence[str]) -> Path:
    """Joint states and commands in messages of someone's own, with their definitions, as Foxglove's writers do it."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
    from mcap.writer import Writer

    file = descriptor_pb2.FileDescriptorProto(name="lab.proto", package="lab", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    state = file.message_type.add(name="JointState")
    kind = descriptor_pb2.FieldDescriptorProto
    state.field.add(name="timestamp", number=1, type=kind.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp", label=1)
    state.field.add(name="name", number=2, type=kind.TYPE_STRING, label=kind.LABEL_REPEATED)
    for number, part in enumerate(("position", "velocity", "effort"), 3):
        state.field.add(name=part, number=number, type=kind.TYPE_DOUBLE, label=kind.LABEL_REPEATED)
    both, stamps = descriptor_pb2.FileDescriptorSet(), descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamps)
    both.file.extend([stamps, file])
    pool = descriptor_pool.DescriptorPool()
    for one in both.file:
        pool.Add(one)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName("lab.JointState"))
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("lab.JointState", "protobuf", both.SerializeToString())
        topics = [writer.register_channel(t, "protobuf", schema) for t in ("/joint_states", "/joint_commands")]
        for t, q, v, tau, u in zip(log.time, log.pos, log.vel, log.torque, log.command, strict=True):
            at = timestamp_pb2.Timestamp(seconds=int(EPOCH + t), nanos=round((EPOCH + t) % 1 * 1e9) % 10**9)
            for topic, parts in zip(
                topics, ({"position": q, "velocity": v, "effort": tau}, {"position": u}), strict=True
            ):
                message = make(name=names, **parts)
                message.timestamp.MergeFromString(at.SerializeToString())
                now = round((EPOCH + t) * 1e9)
                writer.add_message(topic, log_time=now, publish_time=now, data=message.SerializeToString())
        writer.finish()
    return path


def joint_states(
    log: Log, names: Sequence[str], *, topic: str = "/joint_states", offset: float = 0.0, drift: float = 0.0,
    wait: float = 0.004, order: Sequence[int] | None = None,
) -> list[tuple[str, str, str, float, dict[str, Any]]]:  # fmt: skip
    """JointState messages whose stamps run `offset` s behind the receiver's clock, and drift."""
    at = list(range(len(names))) if order is None else list(order)
    rng = np.random.default_rng(5)
    found = []
    for i, t in enumerate(log.time):
        own = EPOCH + t
        received = own + offset + drift * t + wait + rng.exponential(0.001)
        message = {
            "header": header(own), "name": [names[j] for j in at], "position": log.pos[i][at].tolist(),
            "velocity": log.vel[i][at].tolist(), "effort": log.torque[i][at].tolist(),
        }  # fmt: skip
        found.append((topic, "sensor_msgs/msg/JointState", JOINT_STATE, received, message))
    return found


def float_commands(log: Log, *, topic: str = "/position_controller/commands", offset: float = 0.0) -> list[Any]:
    """Float64MultiArray, as forward command controllers take: no names, no stamp."""
    empty = {"dim": [], "data_offset": 0}
    return [
        (topic, "std_msgs/msg/Float64MultiArray", COMMANDS, EPOCH + t + offset, {"layout": empty, "data": c.tolist()})
        for t, c in zip(log.time, log.command, strict=True)
    ]


def bag(path: Path, log: Log, names: Sequence[str], version: int, more: Any = None) -> Path:
    """A ROS 1 bag, or a ROS 2 bag in sqlite, with JointState and a JointState of commands.

    `more` is given a function that sends (topic, message, s since the start), for further messages.
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    t_ = store.types
    writer: Any
    if version == 1:
        from rosbags.rosbag1 import Writer as Writer1

        writer = Writer1(path)
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        writer = Writer2(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    kind = "sensor_msgs/msg/JointState"
    with writer as out:
        state = out.add_connection("/joint_states", kind, typestore=store)
        asked = out.add_connection("/joint_command", kind, typestore=store)
        for i, t in enumerate(log.time):
            sec = EPOCH + t
            when = t_["builtin_interfaces/msg/Time"](**stamp(sec))
            extra = {"seq": i} if version == 1 else {}
            head = t_["std_msgs/msg/Header"](stamp=when, frame_id="", **extra)
            none = np.zeros(0)
            said = t_[kind](header=head, name=list(names), position=log.command[i], velocity=none, effort=none)
            read = t_[kind](
                header=head, name=list(names), position=log.pos[i], velocity=log.vel[i], effort=log.torque[i]
            )
            pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
            out.write(state, round((sec + 0.003) * 1e9), pack(read, kind))
            out.write(asked, round(sec * 1e9), pack(said, kind))
        if more is not None:
            others: dict[str, Any] = {}

            def send(topic: str, message: Any, seconds: float) -> None:
                last = message.__msgtype__
                if topic not in others:
                    others[topic] = out.add_connection(topic, last, typestore=store)
                out.write(others[topic], round((EPOCH + seconds) * 1e9), pack(message, last))

            more(send)
    return path


def unitree(path: Path, log: Log, order: Sequence[int], *, definitions: bool = False) -> Path:
    """LowState and LowCmd of a Go2 in its SDK's motor order; by default without definitions, as bags of Humble are."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from realsim.core.bags.definitions import register

    store = register(get_typestore(Stores.ROS2_HUMBLE), get_types_from_msg)
    t_ = store.types
    assert log.acc is not None
    assert log.gyro is not None
    assert log.quat is not None
    assert log.force is not None
    go = "unitree_go/msg/"
    bms = t_[f"{go}BmsState"](0, 0, 0, 90, 0, 1, np.zeros(2, np.int8), np.zeros(2, np.int8), np.zeros(15, np.uint16))
    feet = [1, 0, 3, 2]  # FR FL RR RL
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as out:
        state = out.add_connection("/lowstate", f"{go}LowState", typestore=store)
        asked = out.add_connection("/lowcmd", f"{go}LowCmd", typestore=store)
        for i, t in enumerate(log.time):
            motors, cmds = [], []
            for k in range(20):
                j = order[k] if k < len(order) else None
                q, dq, tau = (log.pos[i, j], log.vel[i, j], log.torque[i, j]) if j is not None else (0.0, 0.0, 0.0)
                motors.append(t_[f"{go}MotorState"](1, q, dq, 0.0, tau, q, dq, 0.0, 30, 0, np.zeros(2, np.uint32)))
                sent = log.command[i, j] if j is not None else 0.0
                cmds.append(t_[f"{go}MotorCmd"](1, sent, 0.0, 0.0, 40.0, 1.5, np.zeros(3, np.uint32)))
            imu = t_[f"{go}IMUState"](
                log.quat[i].astype(np.float32), log.gyro[i].astype(np.float32), log.acc[i].astype(np.float32),
                np.zeros(3, np.float32), 40,
            )  # fmt: skip
            low = t_[f"{go}LowState"](
                np.zeros(2, np.uint8), 0, 0, np.zeros(2, np.uint32), np.zeros(2, np.uint32), 0, imu, motors, bms,
                log.force[i][feet].astype(np.int16), np.zeros(4, np.int16), round(1000 * t) + 5000,
                np.zeros(40, np.uint8), 0, 0.0, 0, 0, 30.0, 1.0, np.zeros(4, np.uint16), 0, 0,
            )  # fmt: skip
            cmd = t_[f"{go}LowCmd"](
                np.zeros(2, np.uint8), 0, 0, np.zeros(2, np.uint32), np.zeros(2, np.uint32), 0, cmds,
                t_[f"{go}BmsCmd"](0, np.zeros(3, np.uint8)), np.zeros(40, np.uint8), np.zeros(12, np.uint8),
                np.zeros(2, np.uint8), 0, 0, 0,
            )  # fmt: skip
            now = round((EPOCH + t) * 1e9)
            out.write(state, now + 1_000_000, store.serialize_cdr(low, f"{go}LowState"))
            out.write(asked, now, store.serialize_cdr(cmd, f"{go}LowCmd"))
    if not definitions:
        with sqlite3.connect(next(path.glob("*.db3"))) as database:
            database.execute("DELETE FROM message_definitions")
    return path


def lerobot(folder: Path, logs: Sequence[Log], names: Sequence[str]) -> Path:
    """A v3.0 dataset: episodes behind each other in one file; degrees, as SO-101 recordings are."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    rows: dict[str, list[Any]] = {k: [] for k in ("action", "observation.state", "timestamp", "episode_index", "index")}
    for episode, log in enumerate(logs):
        rows["action"] += np.degrees(log.command).astype(np.float32).tolist()
        rows["observation.state"] += np.degrees(log.pos).astype(np.float32).tolist()
        rows["timestamp"] += log.time.tolist()
        rows["episode_index"] += [episode] * len(log.time)
        rows["index"] += list(range(len(log.time)))
    pq.write_table(pa.table(rows), folder / "data" / "chunk-000" / "file-000.parquet")
    feature = {"dtype": "float32", "shape": [len(names)], "names": [f"{n}.pos" for n in names]}
    info = {
        "codebase_version": "v3.0", "robot_type": "so101_follower", "fps": 250,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {
            "action": feature, "observation.state": feature,
            "observation.images.front": {"dtype": "video", "shape": [480, 640, 3], "names": ["h", "w", "c"]},
        },
    }  # fmt: skip
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return folder


def ulog(path: Path, stamps: np.ndarray, message: str, columns: dict[str, np.ndarray]) -> Path:
    """A ULog file (docs.px4.io, ULog file format) with one message of floats; there is no library that writes one."""

    def block(kind: str, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    fields = "uint64_t timestamp;" + "".join(f"float {n};" for n in columns)
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), block("B", bytes(40))]
    parts.append(block("F", f"{message}:{fields}".encode()))
    parts.append(block("A", struct.pack("<BH", 0, 1) + message.encode()))
    for i, t in enumerate(stamps):
        row = struct.pack(f"<Q{len(columns)}f", round(1e6 * t), *(float(v[i]) for v in columns.values()))
        parts.append(block("D", struct.pack("<H", 1) + row))
    path.write_bytes(b"".join(parts))
    return path


def rrd(path: Path, log: Log, names: Sequence[str]) -> Path:
    """A Rerun recording: positions with the lines' names, each joint's speed, the base's pose, pictures."""
    import rerun as rr

    out = rr.RecordingStream("robot")
    out.save(str(path))
    out.log("joints/position", rr.SeriesLines(names=list(names)), static=True)
    for i, t in enumerate(log.time):
        out.set_time("step", sequence=i)
        out.set_time("clock", timestamp=EPOCH + t)
        out.log("joints/position", rr.Scalars(log.pos[i]))
        out.log("command/q", rr.Scalars(log.command[i]))
        for k, name in enumerate(names):
            out.log(f"{name}/velocity", rr.Scalars(log.vel[i, k]))
        out.log("base", rr.Transform3D(translation=[t, 0.0, 0.3], quaternion=rr.Quaternion(xyzw=[0, 0, 0, 1])))
        if i % 100 == 0:
            out.log("camera", rr.Image(np.zeros((20, 20, 3), np.uint8)))
            out.log("cloud", rr.Points3D(np.zeros((1000, 3))))
    out.flush()
    return path
