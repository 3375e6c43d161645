"""Writes a synthetic capture in the layout of its sensor, and its truth beside it."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from realsim.core.files import output_folder, to_json, write_bytes, write_text
from realsim.core.geometry import make_T
from realsim.core.progress import track
from realsim.core.types import F64, U8
from realsim.synth.camera import DepthSensor, Rig, drift, follow_route, rig, walk
from realsim.synth.config import SynthConfig
from realsim.synth.render import Renderer
from realsim.synth.terrain import Terrain, make_terrain
from realsim.synth.textures import tile
from realsim.synth.truth import sample_truth, write_truth


@dataclass(frozen=True)
class SynthCapture:
    """Where a synthetic capture and its truth lie."""

    capture: Path
    """An Open3D dataset (color/, depth/, camera_intrinsic.json, trajectory.log), or frames as 7-Scenes has them."""
    truth: Path
    """truth.json, mesh.ply and samples.npz, simulation frame."""


def write_capture(
    folder: Path, config: SynthConfig | None = None, *, terrain: Terrain | None = None, overwrite: bool = False
) -> SynthCapture:
    """Render `folder/capture` (colour JPEG, depth PNG in mm) and `folder/truth`.

    Same config, same bytes. The world of the poses is turned at random: nothing in the capture tells where up is.

    Args:
        terrain: what is rendered instead of the config's own terrain.

    Raises:
        RealsimError: unknown terrain, or the folder exists and `overwrite` is not set.
    """
    config = config or SynthConfig()
    terrain = terrain or make_terrain(config.terrain, config.seed, config.once)
    rng = np.random.default_rng([config.seed, 4])
    drawn = float(rng.uniform(0.99, 1.01))
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    T_world_sim = make_T(Q * np.sign(np.linalg.det(Q)), rng.uniform(-1, 1, 3))
    poses = camera_poses(terrain, config, rng)
    scale = drawn if config.depth_scale is None else config.depth_scale
    sensor = DepthSensor(scale)
    cameras = rig(config.sensor, config.width, np.random.default_rng([config.seed, 7]))
    depth, color = (Renderer(terrain.solids, k, config.seed, terrain.lamps) for k in (cameras.depth, cameras.color))
    with output_folder(folder, overwrite=overwrite) as work:
        for material in {solid.material for solid in terrain.solids}:
            tile(material, config.seed)  # once, before threads that would each make it
        capture = work / "capture"
        frame = partial(_write_frame, capture, cameras, depth, color, sensor, config)
        # Arrays of this size release the interpreter lock, so threads share the work; every frame has its own seed.
        with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
            try:
                for _ in track(pool.map(frame, range(len(poses)), poses), "rendering", total=len(poses)):
                    pass
            except BaseException:
                pool.shutdown(cancel_futures=True)  # else an interrupt waits for all frames
                raise
        off = drift(len(poses), config.pose_error, np.random.default_rng([config.seed, 8]))
        _write_cameras(capture, cameras, T_world_sim @ poses @ off, config)
        about = {"depth": asdict(cameras.depth), "color": asdict(cameras.color), "T_depth_color": cameras.T_depth_color}
        truth = {"config": asdict(config), "depth_scale": scale, "sensor": asdict(sensor), "cameras": about}
        write_truth(work / "truth", terrain, sample_truth(terrain, depth, poses), T_world_sim, poses, truth)
    return SynthCapture(folder / "capture", folder / "truth")


def camera_poses(terrain: Terrain, config: SynthConfig, rng: np.random.Generator) -> F64:
    """(config.frames, 4, 4) poses of the camera's way, simulation frame."""
    count = config.frames + config.gap
    if terrain.eyes is None or terrain.aims is None:
        poses = walk(terrain.bounds, count, rng, both_sides=config.both_sides)
    else:
        poses = follow_route(terrain.eyes, terrain.aims, count, rng)
    middle = config.frames // 2
    return np.delete(poses, np.s_[middle : middle + config.gap], axis=0)


def _write_frame(
    folder: Path,
    cameras: Rig,
    of_depth: Renderer,
    of_color: Renderer,
    sensor: DepthSensor,
    config: SynthConfig,
    i: int,
    T: F64,
) -> None:
    import cv2

    rng = np.random.default_rng([config.seed, 5, i])
    color = of_color.color(T @ cameras.T_depth_color)
    if config.noise:
        color = _expose(color, i, rng, config)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 92])
    depth = of_depth.depth(T)
    _, png = cv2.imencode(".png", sensor.measure(depth, rng) if config.noise else sensor.exact(depth))
    kinect = config.sensor == "kinect"
    names = (f"frame-{i:06d}.color.jpg", f"frame-{i:06d}.depth.png") if kinect else (f"{i:06d}.jpg", f"{i:06d}.png")
    write_bytes(folder / ("." if kinect else "color") / names[0], jpeg.tobytes())
    write_bytes(folder / ("." if kinect else "depth") / names[1], png.tobytes())


def _write_cameras(folder: Path, cameras: Rig, T_world_camera: F64, config: SynthConfig) -> None:
    """Intrinsics and, if requested, poses, each in the sensor's layout."""
    if config.sensor == "d435i":
        k = cameras.depth  # Open3D writes the 3x3 matrix column by column
        intrinsics = {"width": k.width, "height": k.height, "intrinsic_matrix": k.K.T.ravel().tolist()}
        write_text(folder / "camera_intrinsic.json", to_json(intrinsics))
        if config.poses:
            rows = (f"{i} {i} {i + 1}\n{_matrix_text(T)}" for i, T in enumerate(T_world_camera))
            write_text(folder / "trajectory.log", "".join(rows))
        return
    # As people have it: the depth camera's figures alone.
    write_text(folder / "camera-intrinsics.txt", _matrix_text(cameras.depth.K))
    for i, T in enumerate(T_world_camera if config.poses else ()):
        write_text(folder / f"frame-{i:06d}.pose.txt", _matrix_text(T))


def _expose(color: U8, i: int, rng: np.random.Generator, config: SynthConfig) -> U8:
    """Slowly changing exposure, darker corners, and noise of the sensor."""
    h, w = color.shape[:2]
    phase = np.random.default_rng([config.seed, 6]).uniform(0, 6)
    gain = 1 + 0.12 * np.sin(phase + 9.0 * i / max(config.frames, 1))
    v, u = np.indices((h, w), np.float32)
    corner = 1 - 0.22 * (((u - w / 2) / w) ** 2 + ((v - h / 2) / h) ** 2) * 2
    noise = rng.normal(0, 2.2, (h, w, 1)) + rng.normal(0, 1.2, (h, w, 3))
    return np.clip(color * (gain * corner)[..., None] + noise, 0, 255).astype(np.uint8)


def _matrix_text(M: F64) -> str:
    return "\n".join(" ".join(f"{v:.10f}" for v in row) for row in M) + "\n"
