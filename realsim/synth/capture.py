"""Writes a synthetic capture in the layout of an Open3D dataset, and its truth beside it."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from realsim.files import output_folder, to_json, write_bytes, write_text
from realsim.geometry import make_T
from realsim.progress import track
from realsim.synth.camera import INTRINSICS, DepthSensor, walk
from realsim.synth.config import SynthConfig
from realsim.synth.render import Renderer
from realsim.synth.terrain import make_terrain
from realsim.synth.truth import sample_truth, write_truth
from realsim.types import F64, U8


@dataclass(frozen=True)
class SynthCapture:
    """Where a synthetic capture and its truth lie."""

    capture: Path
    """color/, depth/, camera_intrinsic.json and, if asked for, trajectory.log."""
    truth: Path
    """truth.json, mesh.ply and samples.npz, simulation frame."""


def write_capture(folder: Path, config: SynthConfig | None = None, *, overwrite: bool = False) -> SynthCapture:
    """Render `folder/capture` (colour JPEG, depth PNG in mm, aligned, 640x480) and `folder/truth`.

    Same config, same bytes. The world of the poses is turned at random: nothing in the capture tells where up is.

    Raises:
        RealsimError: unknown terrain, or the folder exists and `overwrite` is not set.
    """
    config = config or SynthConfig()
    terrain = make_terrain(config.terrain, config.seed)
    rng = np.random.default_rng([config.seed, 4])
    drawn = float(rng.uniform(0.99, 1.01))
    T_world_sim = _random_world(rng)
    poses = walk(terrain.bounds, config.frames, rng, both_sides=config.both_sides)
    scale = drawn if config.depth_scale is None else config.depth_scale
    sensor = DepthSensor(scale)
    renderer = Renderer(terrain.solids, INTRINSICS, config.seed)
    with output_folder(folder, overwrite=overwrite) as work:
        capture = work / "capture"
        # Arrays of this size release the interpreter lock, so threads share the work; every frame has its own seed.
        with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
            jobs = pool.map(lambda i: _write_frame(capture, i, poses[i], renderer, sensor, config), range(len(poses)))
            for _ in track(jobs, "rendering", total=len(poses)):
                pass
        write_text(capture / "camera_intrinsic.json", _intrinsics_text())
        if config.poses:
            write_text(capture / "trajectory.log", _trajectory_text(T_world_sim @ poses))
        truth = {"config": asdict(config), "depth_scale": scale, "sensor": asdict(sensor)}
        write_truth(work / "truth", terrain, sample_truth(terrain, renderer, poses), T_world_sim, poses, truth)
    return SynthCapture(folder / "capture", folder / "truth")


def _write_frame(
    folder: Path, i: int, T: F64, renderer: Renderer, sensor: DepthSensor, config: SynthConfig
) -> None:  # fmt: skip
    import cv2

    rng = np.random.default_rng([config.seed, 5, i])
    color = renderer.color(T)
    if config.noise:
        color = _expose(color, i, rng, config)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(color, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 92])
    depth = renderer.depth(T)
    _, png = cv2.imencode(".png", sensor.measure(depth, rng) if config.noise else sensor.exact(depth))
    write_bytes(folder / "color" / f"{i:06d}.jpg", jpeg.tobytes())
    write_bytes(folder / "depth" / f"{i:06d}.png", png.tobytes())


def _expose(color: U8, i: int, rng: np.random.Generator, config: SynthConfig) -> U8:
    """Slowly changing exposure, darker corners, and noise of the sensor."""
    h, w = color.shape[:2]
    phase = np.random.default_rng([config.seed, 6]).uniform(0, 6)
    gain = 1 + 0.12 * np.sin(phase + 9.0 * i / max(config.frames, 1))
    v, u = np.indices((h, w), np.float32)
    corner = 1 - 0.22 * (((u - w / 2) / w) ** 2 + ((v - h / 2) / h) ** 2) * 2
    noise = rng.normal(0, 2.2, (h, w, 1)) + rng.normal(0, 1.2, (h, w, 3))
    return np.clip(color * (gain * corner)[..., None] + noise, 0, 255).astype(np.uint8)


def _random_world(rng: np.random.Generator) -> F64:
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return make_T(Q * np.sign(np.linalg.det(Q)), rng.uniform(-1, 1, 3))


def _intrinsics_text() -> str:
    k = INTRINSICS
    # Open3D writes the 3x3 matrix column by column.
    return to_json({"width": k.width, "height": k.height, "intrinsic_matrix": k.K.T.ravel().tolist()})


def _trajectory_text(T_world_camera: F64) -> str:
    blocks = []
    for i, T in enumerate(T_world_camera):
        rows = "\n".join(" ".join(f"{v:.10f}" for v in row) for row in T)
        blocks.append(f"{i} {i} {i + 1}\n{rows}\n")
    return "".join(blocks)
