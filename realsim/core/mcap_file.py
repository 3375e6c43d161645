"""MCAP files with JSON messages, which Foxglove, PlotJuggler and Rerun open."""

import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from realsim import __version__
from realsim.core.errors import extra
from realsim.core.files import write_bytes

NUMBER: Mapping[str, Any] = {"type": "number"}
TIME: Mapping[str, Any] = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def write_mcap(
    path: Path,
    topics: Mapping[str, tuple[str, Mapping[str, Any]]],
    messages: Iterable[tuple[str, float, Mapping[str, Any]]],
) -> None:
    """Write an MCAP file, the same bytes for the same messages.

    Args:
        topics: topic -> (name of its schema, JSON Schema). Names that begin with `foxglove.` are known to viewers.
        messages: (topic, time in seconds, message), in any order.

    Raises:
        MissingExtraError: the package mcap is not installed.
    """
    writing = extra("mcap.writer", "logs", "writing .mcap")
    buffer = io.BytesIO()
    writer = writing.Writer(buffer)
    writer.start(profile="", library=f"realsim {__version__}")
    channels = {}
    for topic, (name, schema) in topics.items():
        known = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        channels[topic] = writer.register_channel(topic, "json", known)
    for count, (topic, time, message) in enumerate(sorted(messages, key=lambda m: m[1])):
        stamp = max(round(1e9 * time), 0)
        writer.add_message(channels[topic], stamp, json.dumps(message).encode(), stamp, count)
    writer.finish()
    write_bytes(path, buffer.getvalue())


def stamped(seconds: float) -> dict[str, int]:
    """A time as viewers want it."""
    whole = max(round(1e9 * seconds), 0)
    return {"sec": whole // 10**9, "nsec": whole % 10**9}
