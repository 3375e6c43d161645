"""Small rendered scenes whose truth is known: boxes on a floor, seen by cameras, in a world that lies askew."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from realsim.core.geometry import exp_so3, make_T
from realsim.core.types import F64, Frame, Intrinsics, MetricScene, PointView, ScaleEstimate
from realsim.synth.camera import look_at

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
Box = tuple[tuple[float, float, float], tuple[float, float, float], float]
"""Centre of the bottom (x, y, z), size (x, y, z), yaw."""


def cast(T: F64, boxes: list[Box], floor: bool) -> F64:
    """(H, W) exact depth along z of boxes and the plane z = 0 (slab method, Kay & Kajiya 1986), 0 where nothing is."""
    rays = CAMERA.rays().reshape(-1, 3).astype(np.float64) @ T[:3, :3].T
    eye = T[:3, 3]
    depth = np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if floor:
            t = -eye[2] / rays[:, 2]
            depth = np.where(t > 0, np.minimum(depth, t), depth)
        for bottom, size, yaw in boxes:
            R = exp_so3([0, 0, yaw])
            o = (eye - np.array(bottom) - [0, 0, size[2] / 2]) @ R
            d = rays @ R
            half = np.array(size) / 2
            near, far = (-half - o) / d, (half - o) / d
            enter = np.minimum(near, far).max(1)
            leave = np.maximum(near, far).min(1)
            depth = np.where((enter > 0) & (enter <= leave), np.minimum(depth, enter), depth)
    return np.where(depth < 8, depth, 0).reshape(CAMERA.height, CAMERA.width)


@pytest.fixture(scope="session")
def render() -> Callable[..., MetricScene]:
    """`render(boxes, poses, floor=True, noise=0.001, T_world_true=None, seed=0)` is the metric scene of a capture."""

    def make(
        boxes: list[Box],
        poses: list[F64],
        *,
        floor: bool = True,
        noise: float = 0.001,
        T_world_true: F64 | None = None,
        seed: int = 0,
        up_world: F64 | None = None,
    ) -> MetricScene:
        T_world_true = np.eye(4) if T_world_true is None else T_world_true
        images = []
        for i, T in enumerate(poses):
            rng = np.random.default_rng([seed, i])
            z = cast(T, boxes, floor)
            z = np.where(z > 0, z + noise * z**2 * rng.standard_normal(z.shape), 0)
            z[rng.random(z.shape) < 0.01] = 0
            images.append(z.astype(np.float32))
        frames = tuple(
            Frame(f"{i:04d}", CAMERA, lambda z=z: z, T_world_camera=T_world_true @ T)
            for i, (z, T) in enumerate(zip(images, poses, strict=True))
        )

        def load(i: int) -> PointView:
            z = images[i]
            return PointView(CAMERA.rays() * z[..., None], (z > 0).astype(np.float32), z > 0)

        return MetricScene(
            frames=frames,
            T_world_camera=np.stack([T_world_true @ T for T in poses]),
            load=load,
            scale=ScaleEstimate(1.0, (1.0, 1.0), (1.0,) * len(frames), 0.0, "truth"),
            backend="truth",
            world_is_capture=True,
            up_world=up_world,
        )

    return make


START: Box = ((0.0, 0.0, 0.0), (0.8, 0.7, 0.30), 0.0)
GOAL: Box = ((2.4, 0.3, 0.0), (0.8, 0.7, 0.25), 0.1)
STEPS: list[Box] = [((0.9, 0.1, 0.0), (0.2, 0.2, 0.2), 0.3), ((1.4, 0.2, 0.0), (0.2, 0.25, 0.22), 0.7)]
WALL: Box = ((1.2, 3.0, 0.0), (6.0, 0.1, 2.5), 0.0)
CLUTTER: Box = ((1.0, -2.2, 0.0), (0.4, 0.4, 0.5), 0.4)


@pytest.fixture(scope="session")
def course() -> list[Box]:
    """Two platforms, two steps between them, a wall along one side and a box that does not belong to it."""
    return [START, GOAL, *STEPS, WALL, CLUTTER]


@pytest.fixture(scope="session")
def walk() -> Callable[..., list[F64]]:
    """`walk(count, roll)`: from behind the start, round one side, to behind the goal and back on the other side."""

    def make(count: int = 14, roll: float = 0.0) -> list[F64]:
        angle = np.linspace(np.pi, 3 * np.pi, count, endpoint=False)
        eyes = np.column_stack([1.2 + 2.4 * np.cos(angle), 0.15 + 1.5 * np.sin(angle), 1.3 + 0.1 * np.sin(3 * angle)])
        targets = np.column_stack([1.2 + 0.9 * np.cos(angle), 0.15 + 0.1 * np.sin(angle), np.full(count, 0.1)])
        return [look_at(e, t, roll) for e, t in zip(eyes, targets, strict=True)]

    return make


@pytest.fixture(scope="session")
def askew() -> F64:
    """(4, 4) a world that lies anyhow: T_world_true."""
    return make_T(exp_so3([1.1, -0.7, 2.0]), [3.0, -1.0, 0.5])


@pytest.fixture
def source() -> Path:
    return Path("scan.ply")
