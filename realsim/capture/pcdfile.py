"""PCD files (https://pointclouds.org/documentation/tutorials/pcd_file_format.html): header and points.

Read here rather than by a native library: Open3D 0.20 overruns its buffer on files with padding fields (`_` with COUNT
above 1), which PCL writes for its own colour points, and ends the process.
"""

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.capture.lzf import decompress
from realsim.core.errors import CaptureError
from realsim.core.files import MAX_BINARY_BYTES, check_size, read_bytes, read_head
from realsim.core.geometry import make_T, quat_to_R
from realsim.core.types import F32, F64, U8

HEADER_LIMIT = 8192
MAX_POINTS = 64 * 2**20
ENTRIES = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA")
ENCODINGS = ("ascii", "binary", "binary_compressed")
NUMBERS = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
"""TYPE -> possible SIZEs."""


@dataclass(frozen=True)
class Field:
    """One column of a PCD file."""

    name: str
    dtype: str
    """As numpy writes it: `<f4`."""
    count: int


@dataclass(frozen=True)
class PcdHeader:
    """The header of a PCD file."""

    fields: tuple[Field, ...]
    width: int
    height: int
    viewpoint: tuple[float, ...]
    """tx ty tz qw qx qy qz; the identity if absent."""
    data: str
    """`ascii`, `binary` or `binary_compressed`."""
    offset: int
    """Offset of the data, bytes."""

    @property
    def organised(self) -> bool:
        """Whether the points lie on an image grid."""
        return self.height > 1 and self.width > 1

    @property
    def points(self) -> int:
        return self.width * self.height

    @property
    def color_field(self) -> str | None:
        """`rgb` or `rgba` where the points have colour as PCL packs it: in one number."""
        return next((f.name for f in self.fields if f.name in ("rgb", "rgba") and f.count == 1), None)

    @property
    def T_world_sensor(self) -> F64:
        """(4, 4) the viewpoint as a pose."""
        return make_T(quat_to_R(self.viewpoint[3:]), self.viewpoint[:3])


def read_header(path: Path) -> PcdHeader:
    """The checked header.

    Raises:
        CaptureError: no PCD file, an entry missing or contradictory, or fewer data than the header promises.
    """
    head = read_head(path, HEADER_LIMIT)
    entries: dict[str, list[str]] = {}
    offset = 0
    while "DATA" not in entries:
        end = head.find(b"\n", offset)
        if end < 0:
            raise CaptureError("not a PCD file", file=path, expected="a header that ends in a DATA line")
        words = head[offset:end].decode("latin-1").split()
        offset = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    missing = [name for name in ENTRIES if not entries.get(name)]
    if missing:
        raise CaptureError("not a PCD file", file=path, expected=f"header entries {', '.join(missing)}")
    try:
        header = _parse(entries, offset)
    except ValueError as error:
        raise CaptureError("the PCD header is broken", file=path, found=str(error)) from error
    _check(header, path)
    return header


def read_columns(path: Path, header: PcdHeader) -> dict[str, NDArray]:
    """Field name -> (points, count) values as stored, or (points,) where count is 1; padding fields are left out.

    Raises:
        CaptureError: the data do not hold what the header says.
    """
    data = read_bytes(path, MAX_BINARY_BYTES)[header.offset :]
    try:
        if header.data == "ascii":
            return _ascii(data, header)
        if header.data == "binary":
            record = np.dtype([(f"{i}", f.dtype, (f.count,)) for i, f in enumerate(header.fields)])
            table = np.frombuffer(data, record)  # one point after another
            return {f.name: _squeeze(table[f"{i}"]) for i, f in enumerate(header.fields) if f.name != "_"}
        packed, unpacked = struct.unpack("<II", data[:8])
        return _blocks(decompress(data[8 : 8 + packed], unpacked), header)
    except (ValueError, OverflowError) as error:
        raise CaptureError("corrupt or truncated point cloud", file=path, found=str(error)) from error


def read_points(path: Path) -> tuple[F32, U8 | None]:
    """((H, W, 3) float32 points as stored with NaN where invalid, (H, W, 3) RGB or None). VIEWPOINT is not applied.

    The last few files are remembered, because depth and colour of a frame are requested separately.
    """
    check_size(path)
    return _read_points(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_points(path: Path, changed: int) -> tuple[F32, U8 | None]:
    header = read_header(path)
    columns = read_columns(path, header)
    shape = (header.height, header.width, 3)
    points = np.stack([columns[axis] for axis in "xyz"], -1).astype(np.float32).reshape(shape)
    points.setflags(write=False)
    if header.color_field is None:
        return points, None
    color = unpack_rgb(columns[header.color_field]).reshape(shape)
    color.setflags(write=False)
    return points, color


def unpack_rgb(packed: NDArray) -> U8:
    """(M, 3) RGB of the 32 bits 0x00RRGGBB, which PCL stores as an integer or disguised as a float."""
    bits = packed.astype(np.float32).view(np.uint32) if packed.dtype.kind == "f" else packed.astype(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], -1).astype(np.uint8)


def _blocks(data: bytes, header: PcdHeader) -> dict[str, NDArray]:
    """`binary_compressed`: one field of all points after another."""
    columns, at = {}, 0
    for f in header.fields:
        block = np.frombuffer(data, f.dtype, header.points * f.count, at)
        at += block.nbytes
        if f.name != "_":
            columns[f.name] = _squeeze(block.reshape(header.points, f.count))
    return columns


def _ascii(data: bytes, header: PcdHeader) -> dict[str, NDArray]:
    """`ascii`: one point per line. Doubles hold every 32-bit integer, so colours survive the way through them."""
    width = sum(f.count for f in header.fields)
    values = np.array(data.split(), dtype=float)
    if values.size != header.points * width:
        raise ValueError(f"{values.size} numbers instead of {header.points} points of {width}")
    table = values.reshape(header.points, width)
    columns, at = {}, 0
    for f in header.fields:
        if f.name != "_":
            columns[f.name] = _squeeze(table[:, at : at + f.count]).astype(f.dtype)
        at += f.count
    return columns


def _squeeze(column: NDArray) -> NDArray:
    return column[:, 0] if column.shape[1] == 1 else column


def _parse(entries: dict[str, list[str]], offset: int) -> PcdHeader:
    names, sizes, types = entries["FIELDS"], entries["SIZE"], entries["TYPE"]
    counts = [int(w) for w in entries.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(sizes) == len(counts) == len(types):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT are of different length")
    for size, kind, count in zip(sizes, types, counts, strict=True):
        if int(size) not in NUMBERS.get(kind, ()) or count < 1:
            raise ValueError(f"a field of TYPE {kind}, SIZE {size}, COUNT {count}")
    fields = tuple(
        Field(name, f"<{kind.lower()}{int(size)}", count)
        for name, kind, size, count in zip(names, types, sizes, counts, strict=True)
    )
    viewpoint = tuple(float(w) for w in entries.get("VIEWPOINT", ["0", "0", "0", "1", "0", "0", "0"]))
    if len(viewpoint) != 7 or not np.isfinite(viewpoint).all() or not any(viewpoint[3:]):
        raise ValueError(f"VIEWPOINT {viewpoint} is not a position and a quaternion")
    width, height = int(entries["WIDTH"][0]), int(entries["HEIGHT"][0])
    return PcdHeader(fields, width, height, viewpoint, entries["DATA"][0].lower(), offset)


def _check(header: PcdHeader, path: Path) -> None:
    """The header's promises against the file itself, before anything is allocated for them."""
    single = {f.name for f in header.fields if f.count == 1}
    if not {"x", "y", "z"} <= single:
        names = " ".join(f.name for f in header.fields)
        raise CaptureError("a point cloud without positions", file=path, found=f"fields {names}")
    if not (header.width > 0 and header.height > 0 and header.points <= MAX_POINTS):
        raise CaptureError("an impossible number of points", file=path, found=f"{header.width}x{header.height}")
    if header.data not in ENCODINGS:
        raise CaptureError("unknown PCD encoding", file=path, expected=", ".join(ENCODINGS), found=header.data)
    rest = path.stat().st_size - header.offset
    expected = header.points * sum(np.dtype(f.dtype).itemsize * f.count for f in header.fields)
    if header.data == "binary" and rest != expected:
        raise CaptureError(
            "corrupt or truncated point cloud",
            file=path,
            expected=f"{expected} bytes of points after the header",
            found=f"{rest}",
        )
    if header.data == "binary_compressed":
        lengths = read_head(path, 8, header.offset)
        packed, unpacked = struct.unpack("<II", lengths) if len(lengths) == 8 else (0, 0)
        if unpacked != expected or packed > rest - 8:
            raise CaptureError(
                "corrupt or truncated point cloud",
                file=path,
                expected=f"{packed} bytes that unpack to {expected}",
                found=f"{max(rest - 8, 0)} bytes that claim to unpack to {unpacked}",
            )
