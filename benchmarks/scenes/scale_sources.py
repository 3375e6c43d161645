"""Where a scale can come from: our modes on rendered captures, and simulations of what is not here.

`simulated_*` are stand-ins with stated errors. They show what a scan with such errors would score; they say nothing
about any product. `onnx` and `onnx+depth` run the model that ships.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from realsim import feedforward, scale
from realsim.core.errors import RealsimError
from realsim.core.geometry import exp_so3
from realsim.core.types import F64, Frame, FrameSet, Intrinsics, Pointmaps
from realsim.feedforward.config import OnnxConfig, PointsConfig
from realsim.scale.config import ScaleConfig
from realsim.synth.camera import DepthSensor, walk
from realsim.synth.render import Renderer
from realsim.synth.terrain import Terrain, make_terrain

CAMERA = Intrinsics(320, 240, 307.5, 307.5, 159.0, 120.5)
"""Half the pixels of a D435i's 640 x 480 in each direction."""
SENSOR_SCALE = 0.005
"""Standard deviation of a depth sensor's scale: 95 of 100 are right to 1 percent. Intel promises 2 percent at 2 m."""
TRACKER = (0.003, 0.002)
"""Noise of given metric poses, metres and radians: motion capture, a good tracking camera."""


@dataclass(frozen=True)
class Capture:
    """A rendered capture in memory."""

    terrain: Terrain
    poses: F64
    """(N, 4, 4) true, simulation frame."""
    depth: F64
    """(N, H, W) true z, infinite where empty."""
    frames: FrameSet
    """Without poses."""
    sensor_scale: float
    seeds: tuple[int, int]
    """Of the terrain, and of walk, noise and sensor."""


@dataclass(frozen=True)
class Found:
    """A scene in what its source takes for metres."""

    points: F64
    """(M, 3) its own world."""
    true: F64
    """(M, 3) where each point is in the simulation frame, by its pixel."""
    interval: tuple[float, float] | None = None
    """90 percent interval of the scale, relative to the estimate."""


def make_capture(terrain: str, terrain_seed: int, seed: int, frames: int) -> Capture:
    """`frames` views along one side, colour and noisy depth, 320 x 240."""
    place = make_terrain(terrain, terrain_seed)
    rng = np.random.default_rng([terrain_seed, seed, 17])
    sensor_scale = float(np.exp(rng.normal(0, SENSOR_SCALE)))
    # Half the focal length and half the base in pixels: the noise in metres is that of the full resolution sensor.
    sensor = DepthSensor(sensor_scale, lateral=0.3)
    poses = walk(place.bounds, frames, rng)
    renderer = Renderer(place.solids, CAMERA, 0)  # one set of textures for all: making them takes longer than rendering
    true = np.stack([renderer.depth(T) for T in poses]).astype(float)
    views = []
    for i, T in enumerate(poses):
        depth = (sensor.measure(true[i].astype(np.float32), np.random.default_rng([seed, i, 5])) / 1000).astype(
            np.float32
        )
        noise = np.random.default_rng([seed, i, 6]).normal(0, 2.2, (*true[i].shape, 3))
        color = np.clip(renderer.color(T) + noise, 0, 255).astype(np.uint8)
        views.append(Frame(f"{i:03d}", CAMERA, lambda d=depth: d, lambda c=color: c))
    capture = FrameSet(tuple(views), Path(terrain), "rendered")
    return Capture(place, poses, true, capture, sensor_scale, (terrain_seed, seed))


# ---------------------------------------------------------------- ours


def rgbd(capture: Capture, work: Path) -> Found:
    """Poses from the frames; the sensor's own scale."""
    return _solved(capture.frames, capture, PointsConfig(backend="rgbd", poses="estimate"))


def rgbd_posed(capture: Capture, work: Path) -> Found:
    """With metric poses, noisy as a tracker's: the sensor's scale error is recovered."""
    rng = np.random.default_rng([*capture.seeds, 8])
    poses = capture.poses.copy()
    for T in poses:
        T[:3, 3] += rng.normal(0, TRACKER[0], 3)
        T[:3, :3] = T[:3, :3] @ exp_so3(rng.normal(0, TRACKER[1], 3))
    frames = tuple(f.with_pose(T) for f, T in zip(capture.frames.frames, poses, strict=True))
    return _solved(replace(capture.frames, frames=frames), capture, PointsConfig(backend="rgbd", poses="given"))


def onnx(capture: Capture, work: Path) -> Found:
    """The paper's way: the model that ships by colour alone, metres by the ratio of depths."""
    return _solved(capture.frames, capture, _with_model("onnx", work))


def onnx_depth(capture: Capture, work: Path) -> Found:
    """The poses of the model that ships, refined against the depth."""
    return _solved(capture.frames, capture, _with_model("onnx+depth", work))


def colmap(capture: Capture, work: Path) -> Found:
    """Structure from motion by colour alone, metres by the ratio of depths."""
    return _solved(capture.frames, capture, PointsConfig(backend="colmap"))


def _with_model(backend: str, work: Path) -> PointsConfig:
    """A configuration with the model that ships; its outputs are kept for the other mode."""
    return PointsConfig(backend=backend, poses="estimate", onnx=OnnxConfig(kept_in=work))


def _solved(frames: FrameSet, capture: Capture, config: PointsConfig) -> Found:
    maps = feedforward.pointmaps(frames, feedforward.solve(frames, config), config)
    metric = scale.to_metric(maps, ScaleConfig())
    low, high = (v / metric.scale.value for v in metric.scale.ci90)
    return _found(capture, maps, metric.scale.value, (low, high))


def _found(capture: Capture, maps: Pointmaps, metres: float, interval: tuple[float, float] | None) -> Found:
    """Points of all views, thinned, with the true place of each pixel."""
    rays = CAMERA.rays().astype(float)
    names = [f.name for f in capture.frames.frames]
    points, true = [], []
    for k, frame in enumerate(maps.frames):
        i = names.index(frame.name)
        view = maps.load(k)
        at = np.flatnonzero(view.mask & np.isfinite(capture.depth[i]) & (view.confidence > 0))
        at = at[:: max(1, len(at) // 4000)]
        own = view.points.reshape(-1, 3)[at].astype(float)
        points.append(metres * (own @ maps.T_world_camera[k, :3, :3].T + maps.T_world_camera[k, :3, 3]))
        seen = (rays * capture.depth[i][..., None]).reshape(-1, 3)[at]
        true.append(seen @ capture.poses[i, :3, :3].T + capture.poses[i, :3, 3])
    return Found(np.concatenate(points), np.concatenate(true), interval)


# ---------------------------------------------------------------- simulated

LIDAR_NOISE, LIDAR_DRIFT, LIDAR_SCALE = 0.010, 0.008, 0.003
"""Simulated hand-held LiDAR: range noise and drift in metres, relative scale. Data sheets of such say 1 to 2 cm."""
PHONE_NOISE, PHONE_DRIFT, PHONE_SCALE = 0.006, 0.02, (0.015, 0.02)
"""Simulated phone mesh: vertices and drift in metres, mean and standard deviation of its scale bias."""


def simulated_lidar(capture: Capture, work: Path) -> Found:
    """A cloud of what the cameras saw, with range noise, slow drift and a small scale error."""
    rng = np.random.default_rng([*capture.seeds, 10])
    return _scan(capture, rng, LIDAR_NOISE, LIDAR_DRIFT, 1 + rng.normal(0, LIDAR_SCALE))


def simulated_phone(capture: Capture, work: Path) -> Found:
    """The vertices of a smooth mesh, with more drift and a scale bias."""
    rng = np.random.default_rng([*capture.seeds, 11])
    return _scan(capture, rng, PHONE_NOISE, PHONE_DRIFT, 1 + rng.normal(*PHONE_SCALE))


def _scan(capture: Capture, rng: np.random.Generator, noise: float, drift: float, factor: float) -> Found:
    rays = CAMERA.rays().astype(float)
    true = []
    for z, T in zip(capture.depth, capture.poses, strict=True):
        at = np.flatnonzero(z < 5)
        at = at[:: max(1, len(at) // 4000)]
        own = (rays * np.where(np.isfinite(z), z, 0)[..., None]).reshape(-1, 3)[at]
        true.append(own @ T[:3, :3].T + T[:3, 3])
    points = np.concatenate(true)
    # A slow bend along the course, two waves at most, is what odometry without loops leaves.
    along = points[:, :1] / np.ptp(points[:, 0])
    waves = sum(np.sin(2 * np.pi * (k * along + rng.uniform(0, 1, 3))) for k in (0.5, 1, 2)) / np.sqrt(1.5)
    return Found(factor * (points + drift * waves + rng.normal(0, noise, points.shape)), points)


SOURCES: dict[str, Callable[[Capture, Path], Found]] = {
    "rgbd": rgbd,
    "rgbd, metric poses": rgbd_posed,
    "onnx": onnx,
    "onnx+depth": onnx_depth,
    "colmap + depth ratio": colmap,
    "LiDAR (simulated)": simulated_lidar,
    "phone mesh (simulated)": simulated_phone,
}
OURS = ("rgbd", "rgbd, metric poses", "onnx", "onnx+depth")


def run(source: str, capture: Capture, work: Path) -> Found | str:
    """What a source finds, or why it cannot."""
    try:
        return SOURCES[source](capture, work)
    except RealsimError as error:
        return error.render()
