"""MCAP (https://mcap.dev/spec), chunk by chunk: ROS 2 and ROS 1 definitions, and JSON.

A file that ends in the middle, as when the recorder was killed, is read as far as it goes.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from realsim.errors import GapError, extra
from realsim.logs.messages import Topics, signal_type
from realsim.logs.readers.rosbag import Types
from realsim.logs.recording import Reader, Recording, Window, no_samples

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 512 * 2**20
"""Bytes of one record, packed or unpacked."""


def recognise(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() == ".mcap"


def read(path: Path, window: Window) -> list[Recording]:
    extra("mcap", "logs", "reading .mcap")
    topics = Topics(path)
    skipped: dict[str, str] = {}
    notes: list[str] = []
    channels: dict[int, tuple[str, str, Callable[[bytes], Any] | None]] = {}
    schemas: dict[int, Any] = {}
    types = Types()
    first: float | None = None
    from mcap.records import Channel, Message, Schema

    for record in _records(path, notes):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas.get(record.schema_id)
            name = schema.name if schema is not None else ""
            decode, why = _decoder(record, schema, types)
            channels[record.id] = (record.topic, name, decode)
            if decode is None:
                skipped[record.topic] = f"{name or 'no type'}: {why}"
        elif isinstance(record, Message) and record.channel_id in channels:
            topic, name, decode = channels[record.channel_id]
            received = 1e-9 * record.log_time
            first = received if first is None else first
            if decode is not None and window.holds(received - first):
                topics.add(topic, name, _call(decode, record.data), received)
    streams = topics.streams()
    notes += [f"{topic}: {what}" for topic, what in topics.failures().items()]
    if not streams:
        raise no_samples(path, "topics with joint states, commands, an IMU or a pose", skipped | topics.failures())
    return [Recording(path, path.stem, "mcap", streams, skipped, tuple(notes))]


def _call(decode: Callable[[bytes], Any], data: bytes) -> Callable[[], Any]:
    return lambda: decode(data)


def _records(path: Path, notes: list[str]) -> Iterator[Any]:
    """Schemas, channels and messages in the order of the file; a broken end is noted."""
    from mcap.exceptions import McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    seen = False
    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=MAX_RECORD)
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    if record.uncompressed_size > MAX_RECORD:
                        raise GapError(
                            "a chunk is too large", file=path, expected=f"at most {MAX_RECORD} bytes",
                            found=str(record.uncompressed_size),
                        )  # fmt: skip
                    try:
                        parts = breakup_chunk(record)
                    except Exception as error:  # each compression has its own errors; the next chunk may be whole
                        notes.append(f"{path.name}: a damaged chunk is left out ({_said(error)})")
                        continue
                    seen = True
                    yield from parts
                else:
                    seen = True
                    yield record
        # Damage shows as whatever it leads to: a wrong length, a broken chunk, a text that is none.
        except (McapError, ValueError, KeyError, IndexError, EOFError, RuntimeError, zlib.error, OSError) as error:
            if not seen:
                raise GapError("not a readable MCAP file", file=path, found=_said(error)) from error
            notes.append(f"{path.name} is damaged or cut off: read as far as it goes ({_said(error)})")
        except (MemoryError, OverflowError) as error:
            raise GapError("not a readable MCAP file", file=path, found=_said(error)) from error


def _decoder(channel: Any, schema: Any, types: Types) -> tuple[Callable[[bytes], Any] | None, str]:
    """(how the messages of a channel are decoded, or None; why not)."""
    if schema is not None and not signal_type(schema.name):
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


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:160]


READER = Reader("mcap", "a .mcap file with ROS 1, ROS 2 or JSON messages", recognise, read)
