"""Evidence of the cameras about a place: measured, or seen through."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T, transform
from realsim.core.ordered import by_rows
from realsim.core.types import F32, F64, Bool, Intrinsics

UNIT = 0.0005
"""Metres a step of the stored depth; 16 bits then reach 32 m."""


@dataclass(frozen=True)
class DepthMap:
    """A view's depth at half its size, kept small: 150 kB for 640 x 480."""

    depth: NDArray[np.uint16]
    """(h, w) the nearest depth of each 2 x 2 pixels and their neighbours in steps of UNIT, 0 where none is known."""
    far: NDArray[np.uint16]
    """(h, w) the farthest."""
    camera: Intrinsics
    T_camera_sim: F64
    """(4, 4)."""


def depth_map(depth: F32, camera: Intrinsics, T_sim_camera: F64) -> DepthMap:
    """Keep a depth image (H, W) in metres, 0 where unknown, of a camera of the full size."""
    import cv2

    h, w = depth.shape[0] // 2 * 2, depth.shape[1] // 2 * 2
    a, b, c, d = (depth[i:h:2, j:w:2] for i in (0, 1) for j in (0, 1))
    far = np.maximum(np.maximum(a, b), np.maximum(c, d))
    known = far > 0
    a, b, c, d = (np.where(x > 0, x, np.float32(np.inf)) for x in (a, b, c, d))
    near = np.minimum(np.minimum(a, b), np.minimum(c, d))
    kernel = np.ones((3, 3), np.uint8)
    near = cv2.erode(np.where(known, near, 60).astype(np.float32), kernel)
    far = cv2.dilate(far.astype(np.float32), kernel)
    # A hole next to a pixel makes that pixel unknown: what is in the hole may be near.
    known = cv2.erode(known.astype(np.uint8), kernel) > 0

    def pack(z: NDArray[Any]) -> NDArray[np.uint16]:
        return np.where(known, np.clip(z / UNIT, 0, 65535), 0).astype(np.uint16)

    k = camera
    half = Intrinsics(w // 2, h // 2, k.fx / 2, k.fy / 2, (k.cx - 0.5) / 2, (k.cy - 0.5) / 2)
    return DepthMap(pack(near), pack(far), half, invert_T(T_sim_camera))


def votes(
    points: F64, maps: Sequence[DepthMap], sigma: float, slack: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """How many views look through each point, and how many measure a surface there.

    Args:
        points: (M, 3) simulation frame.
        sigma: noise of inverse depth, 1/m.
        slack: metres that a surface may lie beyond a point, on top of three sigma, and still not be seen through.

    Returns:
        (M,) views that saw something clearly farther, with all neighbouring pixels; (M,) views that saw it there.
    """

    def of_rows(some: slice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        through, measured = np.zeros((2, len(points[some])), np.int32)
        for m in maps:
            P = transform(m.T_camera_sim, points[some])
            v, u, inside = m.camera.pixels(P, near=0.05)
            seen = np.flatnonzero(inside)
            z = P[seen, 2]
            near, far = (depth[v[seen], u[seen]] * UNIT for depth in (m.depth, m.far))
            known = near > 0
            tolerance = slack + 3 * sigma * z**2
            through[seen] += known & (near - z > tolerance)
            measured[seen] += known & (near - z <= tolerance) & (z - far <= tolerance)
        return through, measured

    through, measured = by_rows(of_rows, len(points))
    return through, measured


def seen_through(through: NDArray[np.int32], measured: NDArray[np.int32]) -> Bool:
    """Whether a place is empty: at least two views look through it, and not fewer than half as many measured it."""
    return (through >= 2) & (2 * through > measured)
