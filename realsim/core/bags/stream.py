"""One stream of messages from any bag: a ROS 1 bag, a ROS 2 bag (folder, .db3) or MCAP, whole or cut off."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from realsim.core.bags import mcap_files, mcap_records, protobuf_decoder, ros_decoder
from realsim.core.bags.definitions import register
from realsim.core.errors import RealsimError, extra


@dataclass
class Bag:
    """A recording that is read from its start as often as `messages` is called; nothing is kept in memory."""

    path: Path
    problem: type[RealsimError]
    """What is raised for a file that cannot be read."""
    notes: list[str] = field(default_factory=list)
    """What was damaged, left out or cut off."""
    topics: dict[str, str] = field(default_factory=dict)
    """Topic -> message type, of all that were met."""
    failures: dict[str, str] = field(default_factory=dict)
    """Topic -> why its messages, or some of them, were not decoded."""
    opened: Callable[[Any], None] = lambda bag: None
    """Called with the open bag of rosbags, where it is none of MCAP, before its messages."""
    start: float = 0.0
    """s, time of reception of the first message of any topic."""

    def messages(self, wanted: Callable[[str, str], bool]) -> Iterator[tuple[str, str, Any, float]]:
        """(topic, type, message, time of reception in s) of the topics that `wanted(topic, type)` asks for."""
        for topic, kind, decode, received in self.encoded(wanted):
            try:
                message = decode()
            except Exception as error:  # decoders of damaged messages raise whatever the damage leads to
                self.failures[topic] = f"{kind}: {type(error).__name__}: {error}"[:160]
                continue
            yield topic, kind, message, received

    def encoded(self, wanted: Callable[[str, str], bool]) -> Iterator[tuple[str, str, Callable[[], Any], float]]:
        """The same with what decodes each message, so that what is not needed is not decoded."""
        self.notes.clear()
        files = mcap_files(self.path)
        for topic, kind, decode, data, received in self._of_mcap(files, wanted) if files else self._of_bag(wanted):
            yield topic, kind, partial(decode, data), received

    def _of_mcap(self, files: list[Path], wanted: Callable[[str, str], bool]) -> Iterator[tuple[Any, ...]]:
        extra("mcap", "logs", "reading .mcap")
        from mcap.records import Channel, Message, Schema

        first = True
        for file in files:
            channels: dict[int, tuple[str, str, Any]] = {}
            schemas: dict[int, Any] = {}
            for record in mcap_records(file, self.notes, self.problem):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.id not in channels:
                    channels[record.id] = self._channel(record, schemas.get(record.schema_id), wanted)
                elif isinstance(record, Message) and record.channel_id in channels:
                    topic, kind, decode = channels[record.channel_id]
                    self.start, first = 1e-9 * record.log_time if first else self.start, False
                    if decode is not None:
                        yield topic, kind, decode, record.data, 1e-9 * record.log_time

    def _channel(self, channel: Any, schema: Any, wanted: Callable[[str, str], bool]) -> Any:
        kind = full(schema.name if schema is not None else "")
        self.topics[channel.topic] = kind
        if not wanted(channel.topic, kind):
            return channel.topic, kind, None
        if channel.message_encoding == "json":
            return channel.topic, kind, json.loads
        coded = channel.message_encoding or "?", schema.encoding if schema is not None else "no"
        if coded == ("protobuf", "protobuf"):
            decode, why = protobuf_decoder(schema.name, schema.data)
        elif coded[0] in ("cdr", "ros1") and coded[1] in ("ros2msg", "ros2idl", "ros1msg"):
            decode, why = ros_decoder(schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
        else:
            decode, why = None, f"{coded[0]} with {coded[1]} definition is not read"
        if decode is None:
            self.failures[channel.topic] = f"{kind or 'no type'}: {why}"
        return channel.topic, kind, decode

    def _of_bag(self, wanted: Callable[[str, str], bool]) -> Iterator[tuple[Any, ...]]:
        highlevel = extra("rosbags.highlevel", "logs", "reading ROS bags")
        typesys = extra("rosbags.typesys", "logs", "reading ROS bags")
        first = self.path.suffix == ".bag"
        store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if first else typesys.Stores.LATEST)
        register(store, typesys.get_types_from_msg)
        count = 0
        try:
            with highlevel.AnyReader([self.path], default_typestore=store) as bag:
                self.start = 1e-9 * bag.start_time
                self.opened(bag)
                chosen = []
                for connection in bag.connections:
                    self.topics[connection.topic] = connection.msgtype
                    if not wanted(connection.topic, connection.msgtype):
                        continue
                    if connection.msgtype in bag.typestore.fielddefs:
                        chosen.append(connection)
                    else:
                        self.failures[connection.topic] = f"{connection.msgtype}: its definition is not in the bag"
                for connection, received, data in bag.messages(connections=chosen) if chosen else ():
                    count += 1
                    yield connection.topic, connection.msgtype, _Decode(bag, connection), data, 1e-9 * received
        except RealsimError:
            raise
        except Exception as error:  # rosbags, sqlite and YAML each have their own; all mean a bag that cannot be read
            if count:
                self.notes.append(f"{self.path.name} is damaged: read as far as it goes ({type(error).__name__})")
                return
            raise self.problem(
                "not a readable ROS bag",
                file=self.path,
                expected=".bag, or a folder with metadata.yaml and its .db3 or .mcap",
                found=f"{type(error).__name__}: {error}"[:200],
                hint="of a bag that was cut off: `rosbag reindex` (ROS 1) or `ros2 bag reindex`",
            ) from error


@dataclass(frozen=True)
class _Decode:
    bag: Any
    connection: Any

    def __call__(self, data: bytes) -> Any:
        return self.bag.deserialize(data, self.connection.msgtype)


def full(kind: str) -> str:
    """sensor_msgs/Image -> sensor_msgs/msg/Image."""
    return kind if kind.count("/") != 1 else kind.replace("/", "/msg/", 1)


def stamp_of(message: Any) -> float:
    """s of a message's header; 0 where it has none."""
    header = getattr(message, "header", None)
    stamp = getattr(header, "stamp", None)
    return 0.0 if stamp is None else float(stamp.sec) + 1e-9 * float(stamp.nanosec)
