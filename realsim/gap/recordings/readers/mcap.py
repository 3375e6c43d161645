"""MCAP (https://mcap.dev/spec), chunk by chunk: ROS 2 and ROS 1 definitions, and JSON.

A file that ends in the middle, as when the recorder was killed, is read as far as it goes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from realsim.core.bags import Types, mcap_files, mcap_records
from realsim.core.bags.images import INFO
from realsim.core.bags.stream import full
from realsim.core.errors import extra
from realsim.gap.recordings.depth import Pictures, picture, seen
from realsim.gap.recordings.messages import Topics, signal_type
from realsim.gap.recordings.recording import Reader, Recording, Window, no_samples


def recognise(path: Path) -> bool:
    return bool(mcap_files(path))


def read(path: Path, window: Window) -> list[Recording]:
    extra("mcap", "logs", "reading .mcap")
    topics = Topics(path)
    skipped: dict[str, str] = {}
    notes: list[str] = []
    types, pictures = Types(), Pictures()
    first: float | None = None
    from mcap.records import Channel, Message, Schema

    for file in mcap_files(path):
        channels: dict[int, tuple[str, str, Callable[[bytes], Any] | None]] = {}
        schemas: dict[int, Any] = {}
        for record in mcap_records(file, notes):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in channels:
                schema = schemas.get(record.schema_id)
                name = schema.name if schema is not None else ""
                decode, why = _decoder(record, schema, types)
                channels[record.id] = (record.topic, name, decode)
                if decode is None or picture(name):
                    skipped[record.topic] = f"{name or 'no type'}: {why or 'holds no signals'}"
            elif isinstance(record, Message) and record.channel_id in channels:
                topic, name, decode = channels[record.channel_id]
                received = 1e-9 * record.log_time
                first = received if first is None else first
                if decode is None:
                    continue
                if picture(name):
                    if pictures.wants(topic, name) and (window.holds(received - first) or full(name) == INFO):
                        pictures.take(topics, topic, name, _call(decode, record.data), received)
                elif window.holds(received - first):
                    topics.add(topic, name, _call(decode, record.data), received)
    streams = topics.streams()
    notes += [f"{topic}: {what}" for topic, what in topics.failures().items()]
    if not streams:
        raise no_samples(
            path, "topics with joint states, commands, an IMU or a pose", skipped | topics.failures(), window, notes
        )
    return [seen(Recording(path, path.stem, "mcap", streams, skipped, tuple(notes)), pictures)]


def _call(decode: Callable[[bytes], Any], data: bytes) -> Callable[[], Any]:
    return lambda: decode(data)


def _decoder(channel: Any, schema: Any, types: Types) -> tuple[Callable[[bytes], Any] | None, str]:
    """(how the messages of a channel are decoded, or None; why not)."""
    if schema is not None and not signal_type(schema.name) and not picture(schema.name):
        return None, "holds no signals"
    if channel.message_encoding == "json":
        return json.loads, ""
    if schema is not None and (channel.message_encoding, schema.encoding) in (
        ("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg"),
    ):  # fmt: skip
        return types.decoder(schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
    said = (
        f"{channel.message_encoding or '?'} with {schema.encoding if schema is not None and schema.encoding else 'no'}"
    )
    return None, f"{said} definition is not read"


READER = Reader(
    "mcap", "a .mcap file with ROS 1, ROS 2 or JSON messages, or the folder of a bag of them", recognise, read
)
