"""Pictures as data URIs: colour maps, PNG for figures, WebP for photographs and maps. Same array, same bytes."""

import base64
import struct
import zlib

import numpy as np
from numpy.typing import ArrayLike

from realsim.core.types import U8

# Control colours, evenly spaced, interpolated linearly in sRGB. Height: dark blue to sand, lightness rises throughout,
# so that it also reads in grey. Signed: blue, grey in the middle, red.
HEIGHT = ((58, 70, 120), (38, 108, 150), (34, 150, 152), (96, 188, 126), (192, 214, 108), (252, 236, 168))
SIGNED = ((20, 74, 158), (96, 158, 222), (226, 228, 232), (238, 140, 104), (172, 26, 42))


def colorize(values: ArrayLike, low: float, high: float, colors: tuple[tuple[int, int, int], ...] = HEIGHT) -> U8:
    """(H, W, 4) RGBA of (H, W) values between `low` and `high`; what is not finite is transparent."""
    v = np.asarray(values, float)
    finite = np.isfinite(v)
    t = np.clip((np.where(finite, v, low) - low) / max(high - low, 1e-12), 0, 1) * (len(colors) - 1)
    table = np.asarray(colors, float)
    rgb = [np.interp(t, np.arange(len(colors)), table[:, c]) for c in range(3)]
    return np.stack([*rgb, np.where(finite, 255.0, 0.0)], axis=-1).round().astype(np.uint8)


def png_uri(image: U8) -> str:
    """Data URI of an (H, W, 3) RGB or (H, W, 4) RGBA image (PNG, lossless; ISO/IEC 15948)."""
    h, w, channels = image.shape
    rows = np.empty((h, 1 + w * channels), np.uint8)
    # Filter 1 (difference to the left neighbour) is what smooth pictures compress well with.
    rows[:, 0] = 1
    flat = image.reshape(h, w, channels)
    left = np.zeros_like(flat)
    left[:, 1:] = flat[:, :-1]
    rows[:, 1:] = (flat - left).reshape(h, -1)
    header = struct.pack(">IIBBBBB", w, h, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 9)), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )
    return "data:image/png;base64," + base64.b64encode(data).decode()


def photo_uri(image: U8, width: int, quality: int = 72) -> str:
    """Data URI of an (H, W, 3) RGB or (H, W, 4) RGBA picture, shrunk to at most `width` pixels across (WebP, lossy)."""
    import cv2

    h, w = image.shape[:2]
    if w > width:
        size = (width, max(1, round(h * width / w)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    swap = cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    _, data = cv2.imencode(".webp", cv2.cvtColor(image, swap), [cv2.IMWRITE_WEBP_QUALITY, quality])
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()
