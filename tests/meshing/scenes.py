"""Analytic scenes: boxes and spheres on a floor, seen by ideal cameras with noise. Simulation frame = capture world."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from realsim.core.geometry import invert_T, transform
from realsim.core.types import AlignedScene, Frame, Gravity, Intrinsics, MetricScene, PointView, ScaleEstimate
from realsim.synth.camera import look_at

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)


@dataclass(frozen=True)
class Box:
    """An upright box; `lower` and `upper` corners."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (self.lower - origin) / direction, (self.upper - origin) / direction
        near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
        return np.where((near < far) & (near > 0), near, np.inf)

    def distance(self, points: np.ndarray) -> np.ndarray:
        centre, half = (np.add(self.lower, self.upper)) / 2, np.subtract(self.upper, self.lower) / 2
        q = np.abs(points - centre) - half
        return np.abs(np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0))


@dataclass(frozen=True)
class Ball:
    centre: tuple[float, float, float]
    radius: float

    def hit(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        offset = origin - self.centre
        a, b = (direction**2).sum(-1), direction @ offset
        root = b**2 - a * (offset @ offset - self.radius**2)
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        return np.where((root > 0) & (t > 0), t, np.inf)

    def distance(self, points: np.ndarray) -> np.ndarray:
        return np.abs(np.linalg.norm(points - self.centre, axis=-1) - self.radius)


def floor_hit(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        t = -origin[2] / direction[..., 2]
    return np.where(t > 0, t, np.inf)


def distance(shapes: Sequence[Box | Ball], points: np.ndarray) -> np.ndarray:
    """(M,) metres to the nearest true surface, the floor z = 0 included."""
    return np.min([np.abs(points[:, 2]), *[s.distance(points) for s in shapes]], axis=0)


def looking(eye: Sequence[float], at: Sequence[float]) -> np.ndarray:
    """Pose of a camera at `eye` that looks at `at`, its x axis level."""
    return look_at(np.array(eye, float), np.array(at, float))


def scene(
    shapes: Sequence[Box | Ball],
    poses: Sequence[np.ndarray],
    *,
    noise: float = 0.001,
    seed: int = 0,
    bounds: Sequence[Sequence[float]] = ((-0.8, -0.8, -0.1), (0.8, 0.8, 0.8)),
    T_sim_world: np.ndarray | None = None,
    passing: Sequence[Box | Ball] = (),
) -> AlignedScene:
    """Rendered views with inverse-depth noise (1/m) and flying pixels half way across every depth edge.

    `poses` are T_sim_camera; with `T_sim_world` the capture world differs from the simulation frame. Of `passing` each
    view sees the one of its number.
    """
    T_sim_world = np.eye(4) if T_sim_world is None else T_sim_world
    rng = np.random.default_rng(seed)
    views, rays = [], CAMERA.rays().astype(float)
    for k, T in enumerate(poses):
        direction = rays @ T[:3, :3].T
        there = [*shapes, *passing[k : k + 1]]
        z = np.min([floor_hit(T[:3, 3], direction), *[s.hit(T[:3, 3], direction) for s in there]], axis=0)
        z = np.where(z < 6, z, 0)
        jump = np.abs(np.diff(z, axis=1)) > 0.05
        half = 0.5 * (z[:, 1:] + z[:, :-1])
        z[:, 1:] = np.where(jump & (rng.random(jump.shape) < 0.3), half, z[:, 1:])
        measured = np.where(z > 0, 1 / (1 / np.where(z > 0, z, 1) + noise * rng.normal(size=z.shape)), 0)
        mask = measured > 0
        color = np.full((*z.shape, 3), (200, 100, 50), np.uint8)
        points = (CAMERA.rays() * measured[..., None]).astype(np.float32)
        views.append(PointView(points, mask.astype(np.float32), mask, color))
    world = np.stack([invert_T(T_sim_world) @ T for T in poses])
    frames = tuple(
        Frame(f"{i:03d}", CAMERA, lambda v=v: np.ascontiguousarray(v.points[..., 2]), T_world_camera=world[i])
        for i, v in enumerate(views)
    )
    scale = ScaleEstimate(1.0, (1.0, 1.0), (1.0,) * len(views), 0.0, "test")
    metric = MetricScene(frames, world, lambda i: views[i], scale, "test", True)
    return aligned(metric=metric, bounds=bounds, T_sim_world=T_sim_world)


def aligned(
    *, bounds: Sequence[Sequence[float]], T_sim_world: np.ndarray | None = None, **source: object
) -> AlignedScene:
    """An aligned scene with the floor at z = 0 and no platforms."""
    T = np.eye(4) if T_sim_world is None else T_sim_world
    gravity = Gravity(T[2, :3].copy(), float(T[2, 3]), 0.1, 0.001, 1000, "test")
    return AlignedScene(T, gravity, 0.0, (), np.array(bounds, float), **source)  # type: ignore[arg-type]


def ring(n: int = 12, radius: float = 1.4, height: float = 1.0) -> list[np.ndarray]:
    """Cameras all around that look at the middle."""
    angles = np.arange(n) * 2 * np.pi / n
    return [looking((radius * np.cos(a), radius * np.sin(a), height), (0, 0, 0.1)) for a in angles]


def one_side(n: int = 10) -> list[np.ndarray]:
    """Cameras along y = -1.3 that look across."""
    return [looking((x, -1.3, 0.9), (0.6 * x, 0.1, 0.1)) for x in np.linspace(-0.7, 0.7, n)]


SOURCE = Path("made-by-the-test")
__all__ = ["SOURCE", "Ball", "Box", "aligned", "distance", "looking", "one_side", "ring", "scene", "transform"]
