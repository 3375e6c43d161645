"""The outer parts of an ONNX file, read without the onnx package and without loading its weights.

What onnxruntime says about a broken file is one sentence for all causes. Here the file is walked once, so that a
message can name the cause: not ONNX, weights in another file that is absent, an opset from the future.
"""

import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.core.errors import ModelError
from realsim.core.files import check_size, inside

VARINT, I64, BYTES, I32 = 0, 1, 2, 5
# Field numbers of onnx.proto.
MODEL_IR, MODEL_PRODUCER, MODEL_GRAPH, MODEL_OPSET, MODEL_METADATA = 1, 2, 7, 8, 14
GRAPH_INITIALIZER, GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE = 5, 11, 12, 13
TYPE_OF_VALUE, TENSOR_OF_TYPE, SHAPE_OF_TENSOR, DIMENSION_OF_SHAPE = 2, 1, 2, 1
ONE, UNKNOWN = b"\x08\x01", b"\x1a\x00"
"""A dimension that is 1, and one of which only an empty denotation is given: as long, and any size."""
TENSOR_EXTERNAL, TENSOR_LOCATION = 13, 14
EXTERNAL = 1
MAX_BYTES = 64 * 2**30


@dataclass(frozen=True)
class Envelope:
    """Metadata, inputs and outputs of a model file."""

    path: Path
    ir_version: int
    opset: int
    """Of the standard operators."""
    producer: str
    metadata: dict[str, str] = field(default_factory=dict)
    external: tuple[str, ...] = ()
    """Files of weights beside it, relative to its folder, sorted."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Everything that the model is made of."""
        return (self.path, *(inside(self.path.parent, name) for name in self.external))


def read_envelope(path: Path) -> Envelope:
    """Walk an ONNX file.

    Raises:
        ModelError: absent, empty, not ONNX, or weights in a file that is absent or outside the model's folder.
    """
    check_size(path, MAX_BYTES)
    if path.stat().st_size == 0:
        raise ModelError("the model file is empty", file=path, expected="an ONNX file")
    try:
        with path.open("rb") as file:
            # Not closed by hand: slices of it live as long as an error's traceback does.
            found = _model(path, memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))
    except (ValueError, IndexError, UnicodeDecodeError):
        found = None
    if found is None or not found.opset:
        raise ModelError(
            "not an ONNX file",
            file=path,
            expected="an ONNX model (a protobuf with a graph and an opset)",
            found=_looks_like(path),
        )
    missing = [name for name in found.external if not inside(path.parent, name).is_file()]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise ModelError(
            "the model's weights lie in files that are absent",
            file=path,
            expected=", ".join(missing[:3]) + more + " beside the model",
            hint="copy the .data file along with the .onnx file, under its own name",
        )
    return found


def open_network(path: Path) -> Any:
    """An onnxruntime session of a small network (a policy) on one thread of the CPU.

    Weights in other files are taken from beside the network only, wherever the program was started.

    Raises:
        ModelError: see `read_envelope`; or onnxruntime refuses the network.
    """
    read_envelope(path)
    return open_session(path, str(path))


def open_session(path: Path, model: str | bytes) -> Any:
    """An onnxruntime session of a network's file, or of its content, on one thread; `path` names it in errors."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors come as exceptions
    if isinstance(model, bytes):
        options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path.parent))
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own exception classes share no base but this
        raise ModelError(
            "onnxruntime cannot load the network", file=path, found=str(error).partition("\n")[0]
        ) from error


def with_any_batch(path: Path) -> bytes:
    """A network's file with the first dimension of inputs, outputs and values between unknown where it is 1.

    Whether the network then computes the same for each of many rows is to be tried: its operators may hold the 1, too.
    """
    content = bytearray(path.read_bytes())
    for number, graph in _fields(memoryview(content)):
        for inner, value in _fields(graph) if number == MODEL_GRAPH and not isinstance(graph, int) else ():
            if inner in (GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE):
                first = _first(value, TYPE_OF_VALUE, TENSOR_OF_TYPE, SHAPE_OF_TENSOR, DIMENSION_OF_SHAPE)
                if first == ONE:
                    first[:] = UNKNOWN
    return bytes(content)


def _first(data: int | memoryview | None, *numbers: int) -> Any:
    """The first field of that number in the first field of that number, and so on; None where one is missing."""
    for number in numbers:
        data = (
            None if data is None or isinstance(data, int) else next((v for n, v in _fields(data) if n == number), None)
        )
    return data


def _model(path: Path, data: memoryview) -> Envelope | None:
    ir, opset, producer, graph = 0, 0, "", False
    metadata: dict[str, str] = {}
    external: set[str] = set()
    for number, value in _fields(data):
        if number == MODEL_IR and isinstance(value, int):
            ir = value
        elif isinstance(value, int):
            continue
        elif number == MODEL_PRODUCER:
            producer = str(value, "utf-8")
        elif number == MODEL_OPSET:
            parts = dict(_fields(value))
            domain = parts.get(1, b"")
            if not isinstance(domain, int) and bytes(domain) in (b"", b"ai.onnx"):
                version = parts.get(2, 0)
                opset = version if isinstance(version, int) else 0
        elif number == MODEL_METADATA:
            metadata.update([_pair(value)])
        elif number == MODEL_GRAPH:
            graph = True
            external |= _external(value)
    return Envelope(path, ir, opset, producer, metadata, tuple(sorted(external))) if graph else None


def _external(graph: memoryview) -> set[str]:
    """Names of the files that hold initializers."""
    names = set()
    for number, tensor in _fields(graph):
        if number != GRAPH_INITIALIZER or isinstance(tensor, int):
            continue
        fields = list(_fields(tensor))
        if (TENSOR_LOCATION, EXTERNAL) in fields:
            pairs = dict(_pair(v) for n, v in fields if n == TENSOR_EXTERNAL and not isinstance(v, int))
            names.add(pairs.get("location", ""))
    return names - {""}


def _pair(data: memoryview) -> tuple[str, str]:
    parts = dict(_fields(data))
    key, value = parts.get(1, b""), parts.get(2, b"")
    if isinstance(key, int) or isinstance(value, int):
        raise ValueError("not a pair of texts")
    return str(key, "utf-8"), str(value, "utf-8")


def _fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """(field number, integer or bytes) of a protobuf message; raises ValueError or IndexError on anything else."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        number, wire = tag >> 3, tag & 7
        if number == 0:  # at once: a large file of zeros has many
            raise ValueError("field 0")
        if wire == VARINT:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == BYTES:
            size, at = _varint(data, at)
        elif wire in (I64, I32):
            size = 8 if wire == I64 else 4
        else:
            raise ValueError(f"wire type {wire}")
        if at + size > len(data):
            raise ValueError("a field that ends after the file")
        yield number, data[at : at + size]
        at += size


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number without an end")


def _looks_like(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(8)
    known = {b"PK\x03\x04": "a zip archive (a torch checkpoint?)", b"\x89HDF": "HDF5", b"\x80\x02": "a pickle"}
    if len(head) == 8 and int.from_bytes(head, "little") < 2**27 and path.suffix == ".safetensors":
        return "safetensors weights"
    return next((what for magic, what in known.items() if head.startswith(magic)), f"bytes that begin {head.hex(' ')}")
