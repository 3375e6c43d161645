"""Messages into columns: any whose definition is known, from ROS, Protobuf or JSON, also of types never heard of.

Numbers keep the names of the message (`motor_state.q`); lists of parts become columns; x, y, z (, w) become one field;
a list of names in the same message labels the columns. Other text, pictures and clouds are left out.
"""

from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.text_table import MAX_WIDTH
from realsim.core.types import F64
from realsim.gap.recordings.recording import Field, Stream, refuse_more
from realsim.gap.recordings.vocabulary import is_clock

NOT_SIGNALS = (
    "Image", "CompressedImage", "PointCloud2", "PointCloud", "LaserScan", "CameraInfo", "OccupancyGrid", "Log",
    "MarkerArray", "Marker", "TFMessage", "RobotDescription", "DiagnosticArray", "ParameterEvent", "HeightMap",
    "CompressedVideo", "FrameTransforms", "SceneUpdate", "RawImage",
)  # fmt: skip
"""Message types that hold no signals of a robot's joints, body or feet."""
NAMES = ("name", "names", "joint_names", "joint_name", "motor_names")
IGNORED = {"reserve", "crc", "wireless_remote", "version", "sn", "head", "lost", "cell_vol", "fan_frequency", "layout"}
"""Members that hold bookkeeping, in messages of many motors most of their size."""


def signal_type(kind: str) -> bool:
    """Whether messages of this type may hold signals."""
    return kind.replace("::", "/").rsplit("/", 1)[-1].rsplit(".", 1)[-1] not in NOT_SIGNALS


@dataclass
class _Columns:
    """Messages of one topic and one shape."""

    labels: Mapping[str, tuple[str, ...]]
    widths: Mapping[str, int]
    receive: array = field(default_factory=lambda: array("d"))
    order: array = field(default_factory=lambda: array("d"))
    clocks: dict[str, array] = field(default_factory=dict)
    values: dict[str, array] = field(default_factory=dict)


class Collector:
    """Gathers the messages of one topic.

    Args:
        path: the recording, for messages.
        name: the topic.
        kind: the message type.
    """

    def __init__(self, path: Path, name: str, kind: str) -> None:
        self.path, self.name, self.kind = path, name, kind
        self._shapes: dict[Any, _Columns] = {}
        self.size = 0

    def add(self, message: Any, receive: float, later: float = 0.0, order: int = 0) -> int:
        """Take one message, received at `receive` s, that holds from `later` s on. Returns how many numbers it held."""
        leaves: dict[str, Any] = {}
        texts: dict[str, tuple[str, ...]] = {}
        stamp = _walk(message, "", leaves, texts)
        clocks = {k: float(leaves.pop(k)) for k in list(leaves) if is_clock(k) and isinstance(leaves[k], float)}
        if stamp:
            clocks["header"] = stamp + later
        labels = {name: found for name in leaves if (found := _labels(name, leaves[name], texts))}
        widths = {name: 1 if isinstance(v, float) else len(v) for name, v in leaves.items()}
        # A topic on which two drivers publish, each its own joints, is two streams.
        key = (tuple(labels.items()), tuple(widths.items()))
        columns = self._shapes.get(key)
        if columns is None:
            columns = self._shapes[key] = _Columns(labels, widths)
            columns.values = {name: array("d") for name in leaves}
            columns.clocks = {name: array("d") for name in clocks}
        for name, value in leaves.items():
            if isinstance(value, float):
                columns.values[name].append(value)
            else:
                columns.values[name].extend(value)
        for name, series in columns.clocks.items():
            series.append(clocks.get(name, np.nan))
        columns.receive.append(receive + later)
        columns.order.append(order)
        count = sum(widths.values())
        self.size += count
        return count

    def streams(self) -> list[Stream]:
        """One stream for every shape in which messages came; rare ones (a joint that drops out) are left aside."""
        most = max((len(c.receive) for c in self._shapes.values()), default=0)
        kept = [c for c in self._shapes.values() if len(c.receive) >= max(2, 0.02 * most)]
        found: list[Stream] = []
        for columns in kept:
            count = len(columns.receive)
            fields = {
                name: Field(_array(series).reshape(count, columns.widths[name]), columns.labels.get(name, ()))
                for name, series in columns.values.items()
                if columns.widths[name]
            }
            clocks = {"receive": _array(columns.receive)} | {n: _array(s) for n, s in columns.clocks.items()}
            if not fields:
                continue
            name = self.name
            if len(kept) > 1:
                first = next(iter(columns.labels.values()), ())
                name += f"[{', '.join(first[:2])}{', ...' if len(first) > 2 else ''}]" if first else f"[{len(found)}]"
            found.append(Stream(name, self.kind, clocks, _axes(fields), _array(columns.order)))
        return found


class Topics:
    """All topics of a recording while it is read; refuses to outgrow the memory."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._collectors: dict[str, Collector] = {}
        self._failures: dict[str, tuple[int, str]] = {}
        self._size = self._count = 0

    def add(self, topic: str, kind: str, decode: Callable[[], Any], receive: float) -> None:
        """Decode and take one message; one that cannot be decoded is counted."""
        try:
            message = decode()
            collector = self._collectors.setdefault(topic, Collector(self.path, topic, kind))
            for later, part in unfold(kind, message):
                self._size += collector.add(part, receive, later, self._count)
            self._count += 1
        except Exception as error:  # decoders of damaged messages raise whatever the damage leads to
            count, _ = self._failures.get(topic, (0, ""))
            self._failures[topic] = (count + 1, f"{type(error).__name__}: {error}"[:120])
        refuse_more(self.path, self._size)

    def streams(self) -> tuple[Stream, ...]:
        return tuple(s for c in self._collectors.values() for s in c.streams())

    def failures(self) -> dict[str, str]:
        """Topic -> what could not be decoded of it."""
        return {topic: f"{n} messages cannot be decoded ({why})" for topic, (n, why) in self._failures.items()}


def unfold(kind: str, message: Any) -> list[tuple[float, Any]]:
    """What a message says, each with the s from its stamp on at which it holds.

    A trajectory is its points; control_msgs/DynamicJointState is one list for each interface.
    """
    last = kind.rsplit("/", 1)[-1]
    if last == "JointTrajectory":
        head = {"header": message.header, "joint_names": message.joint_names}
        return [
            (_stamp({"stamp": p.time_from_start}), head | {"positions": p.positions, "velocities": p.velocities})
            for p in message.points[:MAX_WIDTH]
        ]
    if last == "DynamicJointState":
        by_name: dict[str, dict[str, float]] = {}
        for joint, values in zip(message.joint_names, message.interface_values, strict=True):
            for name, value in zip(values.interface_names, values.values, strict=True):
                by_name.setdefault(name, {})[joint] = float(value)
        lists = [{"name": list(v), name: np.array(list(v.values()))} for name, v in by_name.items()]
        return [(0.0, {"header": message.header, "interfaces": {str(i): part for i, part in enumerate(lists)}})]
    return [(0.0, message)]


def _walk(part: Any, path: str, leaves: dict[str, Any], texts: dict[str, tuple[str, ...]]) -> float:
    """Collect numbers and lists of names below `part`; returns the time stamp of the message in s, or 0."""
    stamp = 0.0
    for name, value in _members(part):
        if name in IGNORED or name.endswith("covariance"):
            continue
        here = f"{path}.{name}" if path else name
        if isinstance(value, (bool, int, float, np.number)):
            leaves[here] = float(value)
        elif isinstance(value, np.ndarray):
            if value.size <= MAX_WIDTH and value.dtype.kind in "fiub":
                leaves[here] = value.ravel()
        elif isinstance(value, str) or value is None:
            continue
        elif isinstance(value, (list, tuple)):
            _walk_list(value, here, leaves, texts)
        elif name in ("header", "stamp") or (is_clock(name) and _stamp(value)):
            stamp = stamp or _stamp(value)
        else:
            _walk(value, here, leaves, texts)
    return stamp


def _walk_list(items: Any, path: str, leaves: dict[str, Any], texts: dict[str, tuple[str, ...]]) -> None:
    if not items or len(items) > MAX_WIDTH:
        return
    if all(isinstance(i, str) for i in items):
        texts[path] = tuple(items)
    elif all(isinstance(i, (bool, int, float, np.number)) for i in items):
        leaves[path] = np.asarray(items, dtype=np.float64)
    elif all(i is None or isinstance(i, (bool, int, float)) for i in items):
        leaves[path] = np.array([np.nan if i is None else i for i in items], dtype=np.float64)
    else:
        _walk_parts(items, path, leaves, texts)


def _walk_parts(items: Any, path: str, leaves: dict[str, Any], texts: dict[str, tuple[str, ...]]) -> None:
    """A list of equal parts (motors, points): every number of a part becomes a field with a column a part."""
    parts: list[dict[str, Any]] = []
    for item in items:
        found: dict[str, Any] = {}
        if hasattr(item, "__dict__") or hasattr(item, "__slots__") or isinstance(item, Mapping):
            _walk(item, "", found, {})
        parts.append(found)
    for name in parts[0]:
        if all(name in p and isinstance(p[name], float) for p in parts):
            leaves[f"{path}.{name}"] = np.array([p[name] for p in parts])
        elif len(parts) == 1 and name in parts[0]:  # a trajectory of one point is a vector
            leaves[f"{path}.{name}"] = parts[0][name]
    named = [dict(_members(i)).get("name") for i in items]
    if all(isinstance(n, str) for n in named):
        texts[f"{path}.name"] = tuple(str(n) for n in named)


def _members(part: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(part, Mapping):
        yield from ((str(k), v) for k, v in part.items())
        return
    names = getattr(part, "__dataclass_fields__", None) or getattr(part, "__slots__", ()) or vars(part)
    for name in names:
        if not name.startswith("_"):
            yield name, getattr(part, name)


def _stamp(part: Any) -> float:
    """s of a ROS header or stamp (sec, nanosec; secs, nsecs in JSON)."""
    found = dict(_members(part))
    inner = found.get("stamp", found)
    if isinstance(inner, (int, float)):
        return float(inner)
    times = dict(_members(inner)) if inner is not None else {}
    sec = times.get("sec", times.get("secs"))
    if not isinstance(sec, (int, np.integer)):
        return 0.0
    return float(sec) + 1e-9 * float(times.get("nanosec", times.get("nsecs", times.get("nsec", 0))))


def _labels(name: str, value: Any, texts: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The names of a field's columns: a list of names of the same length beside it or above it."""
    if isinstance(value, float):
        return ()
    place = name
    while place:
        place = place.rpartition(".")[0]
        for key in NAMES:
            found = texts.get(f"{place}.{key}" if place else key, ())
            if len(found) == len(value) and len(set(found)) == len(found):
                return found
    return ()


def _axes(fields: Mapping[str, Field]) -> dict[str, Field]:
    """Scalars x, y, z (, w) of one part as one field; a lone `rpy` or covariance stays what it is."""
    result: dict[str, Field] = {}
    for name, entry in fields.items():
        place, _, last = name.rpartition(".")
        if last not in ("x", "y", "z", "w") or f"{place}.z" not in fields or entry.width != 1:
            result[name] = entry
            continue
        axes = [a for a in ("x", "y", "z", "w") if f"{place}.{a}" in fields]
        if place not in result:
            columns = [fields[f"{place}.{a}"].values for a in axes]
            result[place] = Field(np.concatenate(columns, axis=1), tuple(axes))
    return result


def _array(series: array) -> F64:
    return np.frombuffer(series, dtype=np.float64) if len(series) else np.zeros(0)
