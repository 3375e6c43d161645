"""Messages into columns: any whose definition is known, from ROS, Protobuf or JSON, also of types never heard of.

Numbers keep the names of the message (`motor_state.q`); lists of parts become columns; x, y, z (, w) become one field;
a list of names in the same message labels the columns. Other text, pictures and clouds are left out.
"""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.text_table import MAX_WIDTH
from realsim.core.types import F64
from realsim.gap.recordings.flatten import flatten
from realsim.gap.recordings.recording import Field, Stream, refuse_more
from realsim.gap.recordings.tables import grouped
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
        values = flatten(message)
        texts = {n: tuple(v) for n, v in values.items() if isinstance(v, (list, tuple)) and v and _words(v)}
        stamp = _number(values.pop("header.stamp", None))
        leaves = {n: v for n, raw in values.items() if _holds_signals(n) and (v := _number(raw)) is not None}
        clocks = {k: float(leaves.pop(k)) for k in list(leaves) if is_clock(k) and isinstance(leaves[k], float)}
        if isinstance(stamp, float) and stamp:
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
            found.append(Stream(name, self.kind, clocks, _together(fields), _array(columns.order)))
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
            (flatten({"s": p.time_from_start})["s"], head | {"positions": p.positions, "velocities": p.velocities})
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


@lru_cache(maxsize=10_000)
def _holds_signals(name: str) -> bool:
    """Whether a dotted name is none of a header's, of bookkeeping or of a covariance."""
    parts = name.split(".")
    return parts[0] != "header" and not any(p in IGNORED or p.endswith("covariance") for p in parts)


def _number(value: Any) -> float | F64 | None:
    """A number or (K,) of a member of a message; None where it holds something else, or a whole cloud."""
    if isinstance(value, (bool, int, float, np.number)):
        return float(value)
    if isinstance(value, np.ndarray):
        return value.ravel() if value.dtype.kind in "fiub" and value.size <= MAX_WIDTH else None
    if not isinstance(value, (list, tuple)) or not 0 < len(value) <= MAX_WIDTH:
        return None
    plain = all(v is None or isinstance(v, (bool, int, float, np.number)) for v in value)
    return np.array(value, dtype=np.float64) if plain else None  # null is missing


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


def _together(fields: Mapping[str, Field]) -> dict[str, Field]:
    """Numbers that belong together as one field: x, y, z of one part, the joints' positions."""
    lone = {n: f.values[:, 0] for n, f in fields.items() if f.width == 1 and not f.labels}
    return {n: f for n, f in fields.items() if n not in lone} | grouped(lone)


def _words(items: Sequence[Any]) -> bool:
    return all(isinstance(i, str) for i in items)


def _array(series: array) -> F64:
    return np.frombuffer(series, dtype=np.float64) if len(series) else np.zeros(0)
