"""ROS image messages to arrays: raw, jpeg, png, and depth as `compressedDepth` packs it; cameras and their topics."""

import io
import re
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from realsim.core.errors import CaptureError
from realsim.core.types import F64, Intrinsics

DEPTHS = ("16UC1", "mono16", "32FC1")
COLORS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3}
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
PART = re.compile(r"^(aligned_depth.*|depth.*|colou?r.*|rgb.*|image.*|infra.*|stereo.*|left.*|right.*|camera_info)$")
"""The component of a topic's name at which the name of its camera ends."""
MAX_PIXELS = 64 * 2**20
HEADER = struct.Struct("<iff")
"""Of compressedDepth: the format, and A and B of a 32-bit depth that is stored as A / depth + B."""


def encoding(message: Any) -> str:
    """`16UC1`, `rgb8`, ...; of compressed images the encoding of what is packed, or its codec."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    text = str(message.format)
    if "compressedDepth" in text:
        return "32FC1" if text.startswith("32FC1") else "16UC1"
    return text.partition(";")[0].strip() or text


def is_depth(topic: str, kind: str) -> bool:
    """Whether images of this encoding on this topic are depth."""
    return kind in DEPTHS and not (kind == "mono16" and "depth" not in topic)


def camera_name(topic: str) -> str:
    """/front/camera/aligned_depth_to_color/image_raw -> /front/camera."""
    parts = topic.strip("/").split("/")
    end = next((i for i, part in enumerate(parts) if PART.match(part)), len(parts) - 1)
    return "/" + "/".join(parts[:end])


def info_beside(topic: str, cameras: Mapping[str, tuple[Intrinsics, bool]]) -> tuple[Intrinsics, bool] | None:
    """The camera of the camera_info topic beside an image topic."""
    name = topic
    while name:
        name = name.rpartition("/")[0]
        if f"{name}/camera_info" in cameras:
            return cameras[f"{name}/camera_info"]
    return None


def packed_depth(image: np.ndarray) -> tuple[str, bytes]:
    """(file ending, bytes) of a depth image: .npy of m where it is float32, else a 16-bit .png."""
    import cv2

    if image.dtype == np.float32:
        buffer = io.BytesIO()
        np.save(buffer, np.where(np.isfinite(image), image, 0).astype(np.float32))
        return ".npy", buffer.getvalue()
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    return ".png", data.tobytes()


def depth_of(message: Any) -> np.ndarray:
    """(H, W) uint16 in mm or float32 in m, as the encoding says.

    Raises:
        CaptureError: another type, or fewer bytes than its size says.
    """
    kind = encoding(message)
    if not hasattr(message, "encoding"):
        return _packed_depth(bytes(message.data), kind)
    if kind not in DEPTHS:
        raise CaptureError("depth of another type", expected=" or ".join(DEPTHS), found=kind)
    size = 4 if kind == "32FC1" else 2
    order = ">" if message.is_bigendian else "<"
    return (
        _rows(message, size, 1)
        .view(f"{order}{'f4' if size == 4 else 'u2'}")
        .astype(np.float32 if size == 4 else np.uint16)
    )


def color_of(message: Any) -> np.ndarray:
    """(H, W, 3) uint8 RGB."""
    import cv2

    if not hasattr(message, "encoding"):
        image = _decoded(bytes(message.data), cv2.IMREAD_COLOR)
        return np.asarray(image[..., ::-1])
    kind = str(message.encoding)
    if kind not in COLORS:
        raise CaptureError("colour of another type", expected=", ".join(COLORS), found=kind)
    image = _rows(message, COLORS[kind], 1).reshape(message.height, message.width, COLORS[kind])
    if COLORS[kind] == 1:
        return np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image[..., [2, 1, 0]] if kind.startswith("bgr") or kind == "8UC3" else image[..., :3])


def camera_of(message: Any) -> tuple[Intrinsics, bool]:
    """(the pinhole camera of a CameraInfo, whether its lens distorts)."""
    K = np.array(getattr(message, "k", getattr(message, "K", None)), float).reshape(3, 3)
    D = np.array(getattr(message, "d", getattr(message, "D", [])), float)
    width, height = int(message.width), int(message.height)
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and 0 < width * height <= MAX_PIXELS):
        raise CaptureError("a camera_info without a camera", expected="K with focal lengths", found=str(K.ravel()))
    return Intrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]), bool(np.any(np.abs(D) > 1e-6))


def seen_from(
    color: np.ndarray, of_color: Intrinsics, depth: F64, of_depth: Intrinsics, T_color_depth: F64
) -> np.ndarray:
    """Colour (H, W, 3) resampled at the pixels of a depth image (H, W) in metres; black where nothing is known."""
    points = of_depth.rays().astype(float) * depth[..., None]
    points = points @ T_color_depth[:3, :3].T + T_color_depth[:3, 3]
    z = np.where(points[..., 2] > 1e-3, points[..., 2], np.nan)
    u = np.nan_to_num(of_color.fx * points[..., 0] / z + of_color.cx, nan=-1.0)
    v = np.nan_to_num(of_color.fy * points[..., 1] / z + of_color.cy, nan=-1.0)
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    good = (column >= 0) & (column < color.shape[1]) & (row >= 0) & (row < color.shape[0]) & (depth > 0)
    out = np.zeros((*depth.shape, 3), np.uint8)
    out[good] = color[row[good], column[good]]
    return out


def _rows(message: Any, size: int, per: int) -> np.ndarray:
    """(H, W * size) uint8 without the padding of rows."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(bytes(message.data), np.uint8)
    row = width * size * per
    if not (0 < height * width <= MAX_PIXELS and step >= row and len(data) >= height * step):
        raise CaptureError(
            "an image is cut off", expected=f"{height} rows of at least {row} bytes", found=f"{len(data)} bytes"
        )
    return np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])


def _packed_depth(data: bytes, kind: str) -> np.ndarray:
    import cv2

    if len(data) > HEADER.size and data[HEADER.size : HEADER.size + 4] == b"\x89PNG":
        _, a, b = HEADER.unpack_from(data)
        data = data[HEADER.size :]
    else:
        a, b = 0.0, 0.0
    raw = _decoded(data, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype != np.uint16:
        raise CaptureError("depth of another type", expected="a 16-bit PNG", found=f"{raw.dtype} {raw.shape}")
    if kind != "32FC1":
        return raw
    with np.errstate(divide="ignore"):
        return np.where(raw > 0, a / (raw.astype(np.float32) - np.float32(b)), 0).astype(np.float32)


def _decoded(data: bytes, flags: int) -> np.ndarray:
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    if image is None or image.size > 3 * MAX_PIXELS:
        raise CaptureError("an image cannot be decoded", expected="jpeg or png", found=f"{len(data)} bytes")
    return image
