"""PCD files (https://pointclouds.org/documentation/tutorials/pcd_file_format.html): the header here, points by Open3D.

The header is read and checked against the file before the native reader sees it: a wrong header must be a message.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from realsim.errors import CaptureError
from realsim.files import check_size
from realsim.geometry import make_T, quat_to_R
from realsim.types import F32, F64, U8

HEADER_LIMIT = 8192
MAX_POINTS = 64 * 2**20
ENTRIES = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT", "DATA")


@dataclass(frozen=True)
class PcdHeader:
    """What the header of a PCD file says."""

    fields: tuple[str, ...]
    width: int
    height: int
    viewpoint: tuple[float, ...]
    """tx ty tz qw qx qy qz; the identity if absent."""
    data: str
    """`ascii`, `binary` or `binary_compressed`."""
    point_bytes: int
    offset: int
    """Where the data start."""

    @property
    def organised(self) -> bool:
        """Whether the points lie on an image grid."""
        return self.height > 1 and self.width > 1

    @property
    def T_world_sensor(self) -> F64:
        """(4, 4) the viewpoint as a pose."""
        return make_T(quat_to_R(self.viewpoint[3:]), self.viewpoint[:3])


def read_header(path: Path) -> PcdHeader:
    """The checked header.

    Raises:
        CaptureError: no PCD file, an entry missing or contradictory, or fewer data than the header promises.
    """
    check_size(path)
    with path.open("rb") as file:
        head = file.read(HEADER_LIMIT)
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


def read_points(path: Path) -> tuple[F32, U8 | None]:
    """((H, W, 3) float32 points as stored with NaN where invalid, (H, W, 3) RGB or None). VIEWPOINT is not applied.

    The last few files are remembered, because depth and colour of a frame are asked for separately.
    """
    check_size(path)
    return _read_points(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_points(path: Path, changed: int) -> tuple[F32, U8 | None]:
    import open3d as o3d

    header = read_header(path)
    cloud = o3d.t.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
    count = header.width * header.height
    if "positions" not in cloud.point or len(cloud.point.positions) != count:
        raise CaptureError("corrupt or truncated point cloud", file=path, expected=f"{count} points")
    shape = (header.height, header.width, 3)
    points = cloud.point.positions.numpy().astype(np.float32).reshape(shape)
    color = cloud.point.colors.numpy().reshape(shape).astype(np.uint8) if "colors" in cloud.point else None
    points.setflags(write=False)
    return points, color


def _parse(entries: dict[str, list[str]], offset: int) -> PcdHeader:
    fields = tuple(entries["FIELDS"])
    sizes = [int(w) for w in entries["SIZE"]]
    counts = [int(w) for w in entries.get("COUNT", ["1"] * len(fields))]
    if not len(fields) == len(sizes) == len(counts) == len(entries["TYPE"]):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT are of different length")
    viewpoint = tuple(float(w) for w in entries.get("VIEWPOINT", ["0", "0", "0", "1", "0", "0", "0"]))
    if len(viewpoint) != 7 or not np.isfinite(viewpoint).all() or not any(viewpoint[3:]):
        raise ValueError(f"VIEWPOINT {viewpoint} is not a position and a quaternion")
    return PcdHeader(
        fields,
        int(entries["WIDTH"][0]),
        int(entries["HEIGHT"][0]),
        viewpoint,
        entries["DATA"][0].lower(),
        sum(size * count for size, count in zip(sizes, counts, strict=True)),
        offset,
    )


def _check(header: PcdHeader, path: Path) -> None:
    """The header's promises against the file itself."""
    if not {"x", "y", "z"} <= set(header.fields):
        raise CaptureError("a point cloud without positions", file=path, found=f"fields {' '.join(header.fields)}")
    count = header.width * header.height
    if not 0 < count <= MAX_POINTS:
        raise CaptureError("an impossible number of points", file=path, found=f"{header.width}x{header.height}")
    rest = path.stat().st_size - header.offset
    expected = count * header.point_bytes
    if header.data == "binary" and rest < expected:
        raise CaptureError(
            "corrupt or truncated point cloud", file=path, expected=f"{expected} bytes of points", found=f"{rest}"
        )
    if header.data == "binary_compressed":
        with path.open("rb") as file:
            file.seek(header.offset)
            lengths = file.read(8)
        packed, unpacked = struct.unpack("<II", lengths) if len(lengths) == 8 else (0, 0)
        if unpacked != expected or packed > rest - 8:
            raise CaptureError(
                "corrupt or truncated point cloud",
                file=path,
                expected=f"{packed} bytes that unpack to {expected}",
                found=f"{rest - 8} bytes that claim to unpack to {unpacked}",
            )
    if header.data not in ("ascii", "binary", "binary_compressed"):
        raise CaptureError("unknown PCD encoding", file=path, found=header.data)
