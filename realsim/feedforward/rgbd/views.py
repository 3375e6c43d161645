"""The points of a view from sensor depth: edges masked, confidence by range, angle and nearness to an edge."""

from functools import lru_cache

import numpy as np

from realsim.core.types import F32, U8, Bool, Frame, Intrinsics, PointView

EDGE = 0.04
"""1/m: inverse depth that changes by more over two pixels is a depth edge (16 cm at 2 m), whatever the slope."""
GRAZING = 0.12
"""Cosine of the view angle below which a surface is too slanted to be measured."""
HALF_RANGE = 2.0
"""Metres at which the range noise has halved the confidence."""


def point_view(frame: Frame, gain: float) -> PointView:
    """Points in the camera frame, metres: `gain` times the sensor's depth along the pixel rays.

    Pixels without depth, at depth edges (where a sensor blends both sides into points in the air) and on grazing
    surfaces are masked. Confidence is the product of range (noise grows with its square), view angle and, where the
    sensor gives one, its own confidence.
    """
    import cv2

    depth = frame.depth() * np.float32(gain)
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    cosine, jump = _slant(depth, frame.intrinsics)
    beside = cv2.dilate(jump.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    mask = (depth > 0) & ~beside & (cosine > GRAZING)
    confidence = cosine / (1 + (depth / HALF_RANGE) ** 2)
    if frame.read_confidence is not None:
        confidence = confidence * frame.read_confidence()
    color = frame.color()
    if color is not None:
        color = resample(color, frame.color_intrinsics or frame.intrinsics, frame.intrinsics, depth, frame.color_shift)
    points = _rays(frame.intrinsics)[0] * depth[..., None]
    return PointView(points, np.where(mask, confidence, 0).astype(np.float32), mask, color)


def _slant(depth: F32, camera: Intrinsics) -> tuple[F32, Bool]:
    """Cosine between ray and surface normal (H, W), and where neighbouring pixels lie on different surfaces.

    On a plane inverse depth q is linear in the image and its gradient is the normal over the offset; noise of depth
    is noise of q of one size at all ranges. Hence both are taken from q, the slope over a window against the noise.
    """
    import cv2

    q = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    valid = (depth > 0).astype(np.float32)
    smooth = cv2.blur(q, (5, 5)) / np.maximum(cv2.blur(valid, (5, 5)), 1e-6)
    filled = np.where(valid > 0, q, smooth)
    soft = cv2.blur(filled, (5, 5))
    nx = cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8) * camera.fx
    ny = cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8) * camera.fy
    rays, ray_lengths = _rays(camera)
    nz = q - nx * rays[..., 0] - ny * rays[..., 1]
    length = np.sqrt(nx**2 + ny**2 + nz**2) * ray_lengths
    cosine = np.abs(q) / np.maximum(length, 1e-9)
    jump = _jumps(q)
    # The windows reach three pixels: so near a step the slope is the step's, and the surface's own is beside.
    across = cv2.dilate(jump.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    beside = cv2.dilate(np.where(across, 0, cosine), np.ones((9, 9), np.uint8))
    cosine = np.where(across, np.maximum(cosine, beside), cosine)
    return np.where(depth > 0, cosine, 0).astype(np.float32), jump


@lru_cache(maxsize=4)
def _rays(camera: Intrinsics) -> tuple[F32, F32]:
    """A camera's rays (H, W, 3) and their lengths (H, W), read-only: most captures have one camera."""
    rays = camera.rays()
    lengths = np.linalg.norm(rays, axis=-1)
    for a in (rays, lengths):
        a.flags.writeable = False
    return rays, lengths


def _jumps(q: F32) -> Bool:
    """Pixels next to a step of inverse depth that is not the continuation of a slope."""
    jump = np.zeros(q.shape, bool)
    for axis in (0, 1):
        v = np.moveaxis(q, axis, 0)
        both = (v[1:] > 0) & (v[:-1] > 0)
        step = np.where(both, np.abs(v[1:] - v[:-1]), 0)
        # Relative to q this is a change of depth of 4 percent and more in one pixel: steeper than grazing surfaces.
        edge = step > np.maximum(EDGE * np.maximum(v[1:], v[:-1]), 0.5 * EDGE)
        out = np.moveaxis(jump, axis, 0)
        out[1:] |= edge
        out[:-1] |= edge
    return jump


def resample(
    color: U8,
    source: Intrinsics,
    target: Intrinsics,
    depth: F32 | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
) -> U8:
    """Colour on another camera's pixel grid; both look the same way. Black outside.

    Args:
        depth: (H, W) metres of the target, 0 where unknown; needed where the cameras do not stand in the same place.
        shift: metres that the source stands right of and below the target.
    """
    import cv2

    if source == target and shift == (0.0, 0.0) and color.shape[:2] == (target.height, target.width):
        return color
    u = ((np.arange(target.width) - target.cx) / target.fx * source.fx + source.cx).astype(np.float32)
    v = ((np.arange(target.height) - target.cy) / target.fy * source.fy + source.cy).astype(np.float32)
    shrinks = source.fx > 1.5 * target.fx
    if shrinks:  # average over what a target pixel covers, or fine texture turns into noise
        color = np.asarray(cv2.blur(color, (round(source.fx / target.fx),) * 2), np.uint8)
    columns, rows = np.meshgrid(u, v)
    if depth is not None and shift != (0.0, 0.0):
        near = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
        columns = (columns - source.fx * shift[0] * near).astype(np.float32)
        rows = (rows - source.fy * shift[1] * near).astype(np.float32)
    return np.asarray(cv2.remap(color, columns, rows, interpolation=cv2.INTER_LINEAR), np.uint8)
