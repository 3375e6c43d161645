"""Reconstructions of a generated course from the sources that the paper compares: camera, LiDAR, phone, by hand.

Each function fills a folder: what was recorded, and `scene`, what `realsim reconstruct` made of it with its defaults.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

import realsim as rs
from realsim.synth.capture import write_capture
from realsim.synth.config import SynthConfig
from realsim.synth.truth import read_truth
from trainer.terrain import Terrain
from trainer.terrain.rendered import in_room

LIDAR_NOISE_M = 0.005
"""One sigma of a handheld scanner's range, after its own mapping."""
PHONE = {"depth_scale": 1.04, "pose_error": 0.01, "width": 320}
"""Depth 4 % longer than the poses' metre, as on a real phone scan (docs/captures.md); poses that drift by 1 cm."""
TAPE_M = 0.01
"""To which a person reads a tape measure."""


def rgbd(terrain: Terrain, folder: Path, seed: int) -> None:
    """Sixty frames of a D435i on a walk along one side; poses are not known."""
    made = write_capture(folder / "frames", SynthConfig(seed=seed), terrain=in_room(terrain, seed), overwrite=True)
    rs.reconstruct(made.capture, folder / "scene")


def phone(terrain: Terrain, folder: Path, seed: int) -> None:
    """Small depth images that disagree with the tracker's metre, and its poses."""
    config = SynthConfig(seed=seed, poses=True, **PHONE)
    made = write_capture(folder / "frames", config, terrain=in_room(terrain, seed), overwrite=True)
    rs.reconstruct(made.capture, folder / "scene")


def lidar(terrain: Terrain, folder: Path, seed: int) -> None:
    """A cloud of what a walk along both sides sees, with noise along the normals."""
    rs.reconstruct(scanned(terrain, folder, seed), folder / "scene")


def scanned(terrain: Terrain, folder: Path, seed: int) -> Path:
    """That cloud, `scan.ply`; the true mesh is in `walk/truth`."""
    config = SynthConfig(seed=seed, both_sides=True, width=160)
    made = write_capture(folder / "walk", config, terrain=in_room(terrain, seed), overwrite=True)
    samples = read_truth(made.truth)[1]
    seen = samples.seen > 0
    noise = np.random.default_rng([seed, 3]).normal(0, LIDAR_NOISE_M, (int(seen.sum()), 1))
    scan = folder / "scan.ply"
    trimesh.PointCloud(samples.points[seen] + noise * samples.normals[seen]).export(scan)
    return scan


def hand(terrain: Terrain, folder: Path, seed: int) -> None:
    """Boxes of sizes and places that were read off a tape measure."""
    parts = []
    for box in terrain.boxes:
        T = box.T.copy()
        T[:3, 3] = np.round(T[:3, 3] / TAPE_M) * TAPE_M
        parts.append(trimesh.creation.box(np.maximum(np.round(box.size / TAPE_M), 1) * TAPE_M, T))
    low, high = np.vstack([p.bounds for p in parts]).min(0) - 1, np.vstack([p.bounds for p in parts]).max(0) + 1
    middle, size = (low + high) / 2, high - low
    floor = trimesh.creation.box((size[0], size[1], 0.05))
    floor.apply_translation((middle[0], middle[1], terrain.floor_z - 0.025))
    folder.mkdir(parents=True, exist_ok=True)
    mesh = folder / "mesh.obj"
    trimesh.util.concatenate([*parts, floor]).export(mesh)
    rs.reconstruct(mesh, folder / "scene")


SOURCES: dict[str, Callable[[Terrain, Path, int], None]] = {"rgbd": rgbd, "lidar": lidar, "phone": phone, "hand": hand}
