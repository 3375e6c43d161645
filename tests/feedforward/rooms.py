"""A small textured room, ray-cast by numpy: frames with exact poses and depth for the tests of this package."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import Frame, FrameSet, Intrinsics

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
BOXES = np.array(
    [  # lower and upper corners, metres; y points down, the floor is y = 0
        [[-0.9, -0.35, 2.0], [-0.4, 0.0, 2.5]],
        [[0.1, -0.5, 2.3], [0.5, 0.0, 2.7]],
        [[0.9, -0.25, 1.8], [1.3, 0.0, 2.4]],
        [[-2.5, -3.0, 3.6], [3.5, 0.0, 3.8]],
    ]
)


@cache
def texture(size: int = 512, seed: int = 0) -> NDArray[np.float64]:
    """(size, size) in 0..1 that repeats seamlessly: smooth noise of several sizes."""
    import cv2

    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for cells, weight in ((32, 1.0), (64, 1.0), (128, 0.6)):
        total += weight * cv2.resize(rng.random((cells, cells)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.clip((total - total.min()) / np.ptp(total), 0, 1)


def ray_cast(T: NDArray[np.float64], camera: Intrinsics, offset: float = 0.0) -> tuple[NDArray, NDArray]:
    """Depth (H, W) and RGB (H, W, 3) of the room; `offset` moves the texture, which makes it another room."""
    rays = camera.rays().astype(float) @ T[:3, :3].T
    origin = T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(rays[..., 1] > 0, -origin[1] / rays[..., 1], np.inf)
        for low, high in BOXES:
            a, b = (low - origin) / rays, (high - origin) / rays
            near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
            t = np.where((near < far) & (near > 0), np.minimum(t, near), t)
    t = np.where(np.isfinite(t) & (t < 8), t, 0)
    point = origin + rays * t[..., None] + offset
    picture = texture()
    # Three slanted projections: every face gets a pattern of its own, none is stretched beyond use.
    u, v = point @ np.array([0.9, 0.3, 0.5]), point @ np.array([-0.4, 0.8, 0.7])
    gray = picture[(u * 200).astype(int) % 512, (v * 200).astype(int) % 512]
    return t, np.where(t > 0, 30 + 200 * gray, 0).astype(np.uint8)[..., None].repeat(3, -1)


def frame(
    k: int,
    T: NDArray[np.float64],
    *,
    noise: float = 0.001,
    color: bool = True,
    offset: float = 0.0,
    posed: bool = False,
) -> Frame:
    """One frame, its depth with noise of `noise` * depth^2."""
    depth, rgb = ray_cast(T, CAMERA, offset)
    depth = (depth + noise * depth**2 * np.random.default_rng(k).standard_normal(depth.shape)) * (depth > 0)
    depth = depth.astype(np.float32)
    pose = T if posed else None
    return Frame(f"{k:03d}", CAMERA, lambda: depth, (lambda: rgb) if color else None, T_world_camera=pose)


def path(n: int, step: float = 0.12) -> NDArray[np.float64]:
    """(n, 4, 4) poses along a bent walk beside the boxes, 1.1 m high, looking down at them."""
    T = []
    for k in range(n):
        x = step * (k - n / 2)
        R = exp_so3([0, -0.15 * x, 0]) @ exp_so3([-0.45, 0, 0]) @ exp_so3([0, 0, 0.03 * np.sin(k)])
        T.append(make_T(R, [x, -1.1 + 0.02 * np.sin(2 * k), 0.1 * np.cos(k)]))
    return np.array(T)


def frame_set(frames: Sequence[Frame]) -> FrameSet:
    return FrameSet(tuple(frames), Path("room"), "test")
