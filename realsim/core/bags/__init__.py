"""ROS bags and MCAP, message by message, without ROS: for robots' logs and for captures.

A file that ends in the middle, as when the recorder was killed, is read as far as it goes.
"""

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from realsim.core.bags.definitions import register
from realsim.core.errors import GapError, RealsimError, extra

MAX_RECORD = 512 * 2**20
"""Bytes of one record of an MCAP file, packed or unpacked."""


@lru_cache(maxsize=256)  # recordings of one robot define the same again and again
def ros_decoder(name: str, encoding: str, definition: str) -> tuple[Callable[[bytes], Any] | None, str]:
    """(decoder of ROS messages of a type, or None; why not): by the definition that comes with them, by ROS' common
    ones where that is empty. `encoding` is ros1msg, ros2msg or ros2idl."""
    typesys = extra("rosbags.typesys", "logs", "reading ROS messages")
    full = name if name.count("/") == 2 else name.replace("/", "/msg/", 1)
    try:
        if definition.strip():
            store = typesys.get_typestore(typesys.Stores.EMPTY)
            if encoding == "ros2idl":
                store.register(typesys.get_types_from_idl(definition))
            else:
                store.register(typesys.get_types_from_msg(definition, full))
        elif full not in (store := _common_types()).fielddefs:
            return None, "its definition is not in the recording"
    except Exception as error:  # a definition of any other dialect; rosbags raises several types
        return None, f"unknown definition ({type(error).__name__}: {str(error)[:80]})"
    read = store.deserialize_ros1 if encoding == "ros1msg" else store.deserialize_cdr
    return lambda data: read(data, full), ""


@cache
def _common_types() -> Any:
    from rosbags import typesys

    return register(typesys.get_typestore(typesys.Stores.LATEST), typesys.get_types_from_msg)


def protobuf_decoder(name: str, definition: bytes) -> tuple[Callable[[bytes], Any] | None, str]:
    """(decoder of Protobuf messages of a type into dictionaries, or None; why not).

    `definition`: a FileDescriptorSet with what the type depends on, as https://mcap.dev/spec/registry has it.
    """
    extra("google.protobuf", "logs", "reading Protobuf messages")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    pool = descriptor_pool.DescriptorPool()
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(definition).file:
            pool.AddSerializedFile(file.SerializeToString())
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except Exception as error:  # a broken definition; protobuf raises several types
        return None, f"unknown definition ({type(error).__name__}: {str(error)[:80]})"
    return lambda data: _members_of(kind.FromString(data)), ""


def _members_of(message: Any) -> dict[str, Any]:
    """A Protobuf message as a dictionary; a moment as ROS has it."""
    if message.DESCRIPTOR.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        return {"sec": message.seconds, "nanosec": message.nanos}
    found: dict[str, Any] = {}
    for part in message.DESCRIPTOR.fields:
        value = getattr(message, part.name)
        if part.type == part.TYPE_BYTES:  # pictures and the like
            continue
        if part.message_type is None:
            found[part.name] = list(value) if part.is_repeated else value
        elif part.message_type.GetOptions().map_entry:
            found[part.name] = {str(k): v for k, v in value.items() if not hasattr(v, "DESCRIPTOR")}
        elif part.is_repeated:
            found[part.name] = [_members_of(v) for v in value]
        elif message.HasField(part.name):
            found[part.name] = _members_of(value)
    return found


def mcap_files(path: Path) -> list[Path]:
    """The file, or those of a ROS 2 bag's folder in the order in which they were recorded (bag_2 before bag_10)."""
    if path.is_dir():
        found = list(path.glob("*.mcap")) if (path / "metadata.yaml").is_file() else []
        return sorted(found, key=lambda f: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", f.name)])
    return [path] if path.is_file() and path.suffix.lower() == ".mcap" else []


def mcap_records(path: Path, notes: list[str], problem: type[RealsimError] = GapError) -> Iterator[Any]:
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
                        raise problem(
                            "a chunk is too large", file=path, expected=f"at most {MAX_RECORD} bytes",
                            found=str(record.uncompressed_size),
                        )  # fmt: skip
                    try:
                        parts = breakup_chunk(record)
                    except Exception as error:  # each compression has its own errors; the next chunk may be whole
                        notes.append(f"{path.name}: a damaged chunk is left out ({_described(error)})")
                        continue
                    seen = True
                    yield from parts
                else:
                    seen = True
                    yield record
        # Damage shows as whatever it leads to: a wrong length, a broken chunk, a text that is none.
        except (McapError, ValueError, LookupError, EOFError, RuntimeError, zlib.error, struct.error, OSError) as error:
            if not seen:
                raise problem("not a readable MCAP file", file=path, found=_described(error)) from error
            notes.append(f"{path.name} is damaged or cut off: read as far as it goes ({_described(error)})")
        except (MemoryError, OverflowError) as error:
            raise problem("not a readable MCAP file", file=path, found=_described(error)) from error


def _described(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:160]
