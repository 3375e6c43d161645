"""Image files to arrays, with every check that keeps a damaged file from becoming a silently wrong frame."""

import io
import struct
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import CaptureError, RealsimError
from realsim.core.files import read_bytes
from realsim.core.types import F32, U8

COLOR_SUFFIXES = (".jpg", ".jpeg", ".png", ".ppm", ".bmp", ".webp")
DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".npy")
MAX_IMAGE_BYTES = 256 * 2**20
MAX_PIXELS = 64 * 2**20
SATURATED = 65535
"""The integer depth that means `nothing measured` besides 0 (Kinect, 7-Scenes)."""


@dataclass(frozen=True)
class DepthImage:
    """A reader of one depth image: `()` -> (H, W) float32 metres, 0 where invalid. Picklable, holds no pixels."""

    path: Path
    unit: float
    """Metres a step of integer images."""
    float_unit: float = 1.0
    """Metres per unit of floating-point images."""

    def __call__(self) -> F32:
        raw = self._raw()
        depth = raw.astype(np.float32) * np.float32(self._unit_of(raw))
        if raw.dtype.kind == "f":
            depth[~np.isfinite(depth) | (depth < 0)] = 0
        else:
            depth[raw == SATURATED] = 0
        return depth

    def step(self) -> float:
        """Metres that the value 1 stands for in this file."""
        return self._unit_of(self._raw())

    def _unit_of(self, raw: NDArray) -> float:
        return self.float_unit if raw.dtype.kind == "f" else self.unit

    def _raw(self) -> NDArray:
        """The values as stored; refused unless they are one channel of 16-bit unsigned or floating-point numbers."""
        raw = _load(self.path)
        # Eight bits cannot hold metric depth at any useful resolution: that is a picture of depth, not depth.
        if raw.ndim != 2 or not (raw.dtype.kind == "f" or (raw.dtype.kind == "u" and raw.dtype.itemsize > 1)):
            viewed = raw.dtype == np.uint8
            raise CaptureError(
                "depth coloured for viewing, not measured" if viewed else "depth of another type",
                file=self.path,
                expected="one channel, 16-bit unsigned or float",
                found=f"{raw.dtype} of shape {raw.shape}",
                hint="metres cannot be had back from it: record depth as 16 bit" if viewed else None,
            )
        return raw


@dataclass(frozen=True)
class ColorImage:
    """A reader of one colour image: `()` -> (h, w, 3) uint8 RGB as stored, never turned by its EXIF orientation."""

    path: Path

    def __call__(self) -> U8:
        return decode_color(read_bytes(self.path, MAX_IMAGE_BYTES), self.path)


@dataclass(frozen=True)
class ConfidenceImage:
    """A reader of one confidence image: `()` -> (H, W) float32, 0 (worst) to 1 (best)."""

    path: Path
    best: int
    """The value that stands for full confidence (ARKit 2, Polycam 255)."""

    def __call__(self) -> F32:
        import cv2

        return confidence(_decode(self.path, cv2.IMREAD_UNCHANGED), self.best, self.path)


def metres(raw: NDArray) -> F32:
    """Floating-point depth in metres (H, W) as float32, 0 where it is NaN, infinite or negative."""
    return np.where(np.isfinite(raw) & (raw > 0), raw, 0).astype(np.float32)


def confidence(raw: NDArray, best: int, source: Path) -> F32:
    """Levels 0 to `best` (uint8, one channel) as 0 to 1.

    Raises:
        CaptureError: another type, or higher levels than there are.
    """
    if raw.dtype != np.uint8 or raw.ndim != 2 or raw.max(initial=0) > best:
        raise CaptureError(
            "confidence image of another type",
            file=source,
            expected=f"one channel of 8 bits, 0 to {best}",
            found=f"{raw.dtype} of shape {raw.shape} up to {raw.max(initial=0)}",
        )
    return raw.astype(np.float32) / np.float32(best)


def common_size(readers: Iterable[Callable[[], NDArray]], look_at: int = 5) -> tuple[int, int] | None:
    """(width, height) that most of the first readable images have; None if none can be read."""
    sizes: list[tuple[int, int]] = []
    for reader in readers:
        try:
            height, width = reader().shape[:2]
        except RealsimError:
            continue
        sizes.append((width, height))
        if len(sizes) == look_at:
            break
    return Counter(sizes).most_common(1)[0][0] if sizes else None


def _load(path: Path) -> NDArray:
    if path.suffix.lower() == ".npy":
        try:
            array = np.load(io.BytesIO(read_bytes(path, MAX_IMAGE_BYTES)), allow_pickle=False)
        except (OSError, ValueError, EOFError, MemoryError) as error:
            raise CaptureError("corrupt array file", file=path, found=str(error)) from error
        if not isinstance(array, np.ndarray):
            raise CaptureError("corrupt array file", file=path, expected="one array", found="an archive")
        return array
    import cv2

    return _decode(path, cv2.IMREAD_UNCHANGED)


def _decode(path: Path, flags: int) -> NDArray:
    return decode(read_bytes(path, MAX_IMAGE_BYTES), flags, path)


def decode_color(data: bytes, source: Path) -> U8:
    """(h, w, 3) RGB of an encoded image, as stored.

    Raises:
        CaptureError: damaged.
    """
    import cv2

    # A viewer would turn the picture upright; the depth image beside it has no such tag and would not follow.
    bgr = decode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, source)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def decode(data: bytes, flags: int, path: Path) -> NDArray:
    """An encoded image through OpenCV's decoder with its `flags`; `path` is only named in errors.

    Raises:
        CaptureError: damaged.
    """
    import cv2

    problem = damage(data)
    if problem is not None:
        raise CaptureError("corrupt or truncated image", file=path, found=problem)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise CaptureError("corrupt or truncated image", file=path, found=str(error.err)) from error
    if image is None:
        raise CaptureError("corrupt or truncated image", file=path, found="the decoder gave up")
    return image


def damage(data: bytes) -> str | None:
    """The fault of an encoded image, or None.

    The decoders paint what is missing of a truncated file grey or black and only print a warning, so the ends of
    JPEG and PNG files are looked at here.
    """
    if not data:
        return "an empty file"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return _png_damage(data)
    # Cameras may append a thumbnail or padding after the end marker, so it is looked for near the end, not at it.
    if data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-4096:]:
        return "no end-of-image marker: the file is cut off"
    return None


def _png_damage(data: bytes) -> str | None:
    """Walk the chunks to IEND; refuse a picture whose header promises more pixels than any camera makes."""
    import zlib

    at, size = 8, len(data)
    while at + 12 <= size:
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        end = at + 12 + length
        if end > size:
            break
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack(">I", data[end - 4 : end])[0]:
            return f"checksum of chunk {kind.decode('latin-1')} does not match"
        if kind == b"IHDR":
            width, height = struct.unpack(">II", data[at + 8 : at + 16])
            if width * height > MAX_PIXELS:
                return f"the header says {width}x{height} pixels"
        if kind == b"IEND":
            return None
        at = end
    return "no end chunk: the file is cut off"
