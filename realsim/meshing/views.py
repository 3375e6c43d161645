"""One view's oriented, weighted surface samples, computed on its pixel grid.

Everything works on inverse depth: there a plane is a linear function of the pixel, and the noise of a stereo or
structured-light sensor is the same at every distance, so one number describes it (its sigma, in 1/m).
"""

from dataclasses import dataclass

import numpy as np

from realsim.core.geometry import transform
from realsim.core.types import F32, F64, U8, Bool, Frame, Intrinsics, PointView

SPAN = 4
"""Pixels to either side over which a slope is measured."""
LATERAL_PX = 0.5
"""Sideways uncertainty of a depth pixel; it is what limits surfaces seen at a grazing angle."""
MIN_COSINE = 0.08
"""Flatter than this toward the ray, and the pixel is more likely a veil between two surfaces than a surface."""


@dataclass(frozen=True)
class Samples:
    """Oriented samples of one view, simulation frame."""

    points: F64
    """(M, 3) metres."""
    normals: F64
    """(M, 3) unit, toward the camera."""
    weights: F64
    """(M,) inverse variance of the distance to the surface, 1/m^2, times confidence."""
    colors: U8 | None
    """(M, 3) RGB or None."""


def inverse_depth(view: PointView) -> F32:
    """(H, W) 1/m, 0 where the view has no point."""
    z = np.where(view.mask, view.points[..., 2], 0)
    return np.divide(1.0, z, out=np.zeros(z.shape, np.float32), where=z > 0).astype(np.float32)


def noise_of(d: F32) -> float:
    """Sigma of inverse depth (1/m) from second differences over 8 pixels, which vanish on planes.

    The median makes edges and creases count little; sqrt(6) is the gain of (1, -2, 1) on white noise. A quarter of a
    promille of the median inverse depth is the floor: noise-free input still has rounding.
    """
    samples = []
    for a, b, c in ((d[:, :-8], d[:, 4:-4], d[:, 8:]), (d[:-8], d[4:-4], d[8:])):
        ok = (a > 0) & (b > 0) & (c > 0)
        samples.append(np.abs(a - 2 * b + c)[ok])
    second = np.concatenate(samples)
    if second.size < 100:
        return 0.0
    valid = d[d > 0]
    return float(max(np.median(second) / 0.6745 / np.sqrt(6), 2.5e-4 * np.median(valid)))


def _slope(d: F32, axis: int, sigma: float, some: tuple[slice, slice]) -> tuple[F32, Bool]:
    """Derivative of inverse depth a pixel along an axis at some pixels, taken from the side that looks like a plane.

    Returns the slope and where it is known. A side is judged by its own second difference, so that at a crease or a
    jump the slope comes from the pixel's own surface (the stencil choice of ENO schemes; Harten et al. 1987).
    """
    h = SPAN // 2
    pad = [(SPAN, SPAN) if k == axis else (0, 0) for k in range(2)]
    p = np.pad(d, pad)

    def at(offset: int) -> F32:
        take = [slice(None), slice(None)]
        take[axis] = slice(SPAN + offset, SPAN + offset + d.shape[axis])
        return p[tuple(take)][some]

    here = d[some]
    sides = []
    for sign in (-1, 1):
        near, far = at(sign * h), at(sign * SPAN)
        bend = np.abs(far - 2 * near + here)
        bend[(near <= 0) | (far <= 0)] = np.inf
        sides.append((sign * (far - here) / SPAN, bend))
    (left, bend_l), (right, bend_r) = sides
    limit = np.float32(2 * sigma)
    both = (bend_l < limit) & (bend_r < limit)
    slope = np.where(both, 0.5 * (left + right), np.where(bend_l < bend_r, left, right))
    return slope.astype(np.float32), np.minimum(bend_l, bend_r) < 8 * np.float32(sigma)


def sample_view(
    view: PointView, camera: Intrinsics, T_sim_camera: F64, bounds: F64, sigma: float, phase: int = 0
) -> tuple[Samples, F32]:
    """Samples of one view inside `bounds` (2, 3), and its smoothed depth (H, W) in metres, 0 where unknown.

    Args:
        camera: of the view's grid.
        sigma: noise of inverse depth, 1/m (`noise_of`).
        phase: which of each 2 x 2 pixels becomes a sample. The smoothing has spread every pixel over its neighbours,
            so that one in four carries nearly all; views take turns.
    """
    import cv2

    d = inverse_depth(view)
    valid = d > 0
    blurred = np.asarray(cv2.bilateralFilter(d, 7, max(3.0 * sigma, 1e-6), 2.5), np.float32)
    smooth: F32 = np.where(valid & (np.abs(blurred - d) < 4 * sigma), blurred, np.float32(0))
    # From here on one pixel in four.
    some = slice(phase % 2, None, 2), slice(phase // 2 % 2, None, 2)
    du, ok_u = _slope(smooth, 1, sigma, some)
    dv, ok_v = _slope(smooth, 0, sigma, some)
    pixels, q, soft, confidence = view.points[some], d[some], smooth[some], view.confidence[some]
    keep = (soft > 0) & ok_u & ok_v & view.mask[some]

    ray = pixels[..., :2] * q[..., None]
    normal = np.empty((*q.shape, 3), np.float32)
    normal[..., 0], normal[..., 1] = -du * camera.fx, -dv * camera.fy
    # Plane n·P = 1 means n·(x, y, 1) = d, hence n_z = d - n_x x - n_y y; the minus turns it toward the camera.
    normal[..., 2] = -soft - normal[..., 0] * ray[..., 0] - normal[..., 1] * ray[..., 1]
    length = np.linalg.norm(normal, axis=-1)
    ray_length = np.sqrt(1 + (ray**2).sum(-1))
    cosine = np.divide(soft, length * ray_length, out=np.zeros_like(q), where=length > 0)
    keep &= cosine > MIN_COSINE

    z = np.divide(1.0, smooth, out=np.zeros_like(d), where=smooth > 0)
    points = transform(T_sim_camera, (pixels[keep] * (z[some][keep] * q[keep])[:, None]).astype(np.float64))
    inside = ((points > bounds[0]) & (points < bounds[1])).all(1)
    keep[keep] = inside
    zk, ck = z[some][keep].astype(np.float64), cosine[keep].astype(np.float64)
    along = sigma * zk**2 * ck
    sideways = LATERAL_PX * zk / max(camera.fx, camera.fy) * np.sqrt(1 - np.minimum(ck, 1) ** 2)
    weights = confidence[keep] * ck / (along**2 + sideways**2 + 1e-8)
    normals = normal[keep] / length[keep, None]
    colors = None if view.color is None else view.color[some][keep]
    return Samples(points[inside], normals.astype(np.float64) @ T_sim_camera[:3, :3].T, weights, colors), z


def camera_of(frame: Frame, view: PointView) -> Intrinsics:
    """The camera of a view's grid, which is the frame's depth image or another sampling of it."""
    height, width = view.mask.shape
    return frame.intrinsics.resized(width, height)
