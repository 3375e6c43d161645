"""A small exact scene for reader tests: a textured floor with a step, seen by a camera that walks along it."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import make_T
from realsim.core.types import Intrinsics

CAMERA = Intrinsics(96, 72, 88.0, 87.0, 46.5, 37.0)
START_TIME = 1_700_000_000.0
PERIOD = 0.1


@dataclass(frozen=True)
class View:
    """One exact view: pose, depth in metres (0 in a small hole), RGB."""

    T_world_camera: NDArray
    depth: NDArray
    color: NDArray
    time: float


@cache
def walk(count: int = 10, camera: Intrinsics = CAMERA) -> tuple[View, ...]:
    """Views along x, looking forward and down, 8 cm apart, turning and rising a little."""
    return tuple(_view(i, camera) for i in range(count))


def render(T_world_camera: NDArray, camera: Intrinsics) -> tuple[NDArray, NDArray]:
    """((H, W) metres, (H, W, 3) RGB): the nearer of the floor z = 0 and a step z = 0.2 for x > 1.2."""
    rays = camera.rays().astype(float) @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    depth = np.full(rays.shape[:2], np.inf)
    hits = np.zeros_like(rays)
    for height in (0.0, 0.2):
        s = (height - origin[2]) / rays[..., 2]
        point = origin + s[..., None] * rays
        valid = (s > 0) & ((point[..., 0] > 1.2) if height else (point[..., 0] <= 1.2))
        nearer = valid & (s < depth)
        depth[nearer], hits[nearer] = s[nearer], point[nearer]
    depth[~np.isfinite(depth)] = 0
    # Reproducible noise over the floor, smooth over about a pixel, so that views overlap in colour too.
    noise = np.random.default_rng(5).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    cell = np.floor(hits[..., :2] / 0.04).astype(int) % 64
    return depth, noise[cell[..., 0], cell[..., 1]]


def _view(i: int, camera: Intrinsics) -> View:
    forward = np.array([np.cos(0.06 * i), np.sin(0.06 * i), -0.9])
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])  # the image's x is to the walker's right
    right /= np.linalg.norm(right)
    R = np.column_stack([right, np.cross(forward, right), forward])
    T = make_T(R, [0.08 * i, 0.01 * i, 1.2 + 0.03 * i])
    depth, color = render(T, camera)
    depth[:6, : 6 + i] = 0
    return View(T, depth, color, START_TIME + PERIOD * i)
