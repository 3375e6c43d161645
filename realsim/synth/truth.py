"""The truth of a synthetic capture on disk: what is there, which part of it was seen, and where the cameras stood."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import RealsimError
from realsim.core.files import read_json, read_npz, to_json, write_bytes, write_text
from realsim.core.geometry import invert_T
from realsim.core.meshes import areas, merged, ply_bytes, sampled
from realsim.core.types import F64
from realsim.synth.render import Renderer
from realsim.synth.solids import Solid
from realsim.synth.terrain import Terrain, top_centroid

FLOOR_MARGIN = 1.0
"""Metres of floor around the terrain that belong to the truth."""
SPACING = 0.012
"""Metres between samples on the true surface."""


@dataclass(frozen=True)
class Samples:
    """Points on the true surface, simulation frame."""

    points: F64
    """(M, 3)."""
    normals: F64
    """(M, 3) out of the surface."""
    solid: NDArray[np.int16]
    """(M,) index of the solid in truth.json, -1 for the floor."""
    seen: NDArray[np.int16]
    """(M,) how many cameras see it."""


def sample_truth(terrain: Terrain, renderer: Renderer, poses: F64) -> Samples:
    """Evenly spread points on platforms, obstacles and the floor around them, with the number of views of each."""
    measured = terrain.of("start", "goal", "obstacle")
    rng = np.random.default_rng(0)
    parts = [(i, *_on_solid(s, rng)) for i, s in enumerate(measured)]
    parts.append((-1, *_on_floor(terrain)))
    points = np.vstack([p for _, p, _ in parts])
    normals = np.vstack([n for _, _, n in parts])
    solid = np.concatenate([np.full(len(p), i, np.int16) for i, p, _ in parts])
    # What lies inside another solid or under one is no surface: nobody sees it.
    seen = np.zeros(len(points), np.int16)
    lifted = points + 1e-4 * normals
    for T in poses:
        seen += renderer.visible(lifted, normals, T)
    return Samples(points, normals, solid, seen)


def _on_solid(solid: Solid, rng: np.random.Generator) -> tuple[F64, F64]:
    count = int(areas(solid.vertices, solid.triangles).sum() / SPACING**2)
    points, face = sampled(solid.vertices, solid.triangles, count, rng)
    return points, solid.normals()[face]


def _on_floor(terrain: Terrain) -> tuple[F64, F64]:
    low, high = terrain.bounds[0, :2] - FLOOR_MARGIN, terrain.bounds[1, :2] + FLOOR_MARGIN
    xy = np.stack(np.meshgrid(np.arange(low[0], high[0], 0.02), np.arange(low[1], high[1], 0.02)), -1).reshape(-1, 2)
    points = np.column_stack([xy, np.full(len(xy), terrain.floor_z)])
    return points, np.broadcast_to([0.0, 0.0, 1.0], points.shape)


def write_truth(
    folder: Path, terrain: Terrain, samples: Samples, T_world_sim: F64, T_sim_camera: F64, extra: Mapping[str, Any]
) -> None:
    """Write truth.json, mesh.ply (terrain and the floor around it) and samples.npz, simulation frame."""
    start, goal = terrain.of("start")[0], terrain.of("goal")[0]
    measured = terrain.of("start", "goal", "obstacle")
    solids = [{"name": s.name, "role": s.role, "material": s.material, "vertices": s.vertices} for s in measured]
    data = {
        "terrain": terrain.name,
        "frame": "origin at the centroid of the start platform's top face, z up, x toward the goal platform's; metres",
        "T_sim_world": invert_T(T_world_sim),
        "T_sim_camera": T_sim_camera,
        "floor_z": terrain.floor_z,
        "bounds": terrain.bounds,
        "start": {"centroid": top_centroid(start)},
        "goal": {"centroid": top_centroid(goal)},
        **extra,
        "solids": solids,
    }
    write_text(folder / "truth.json", to_json(data))
    write_bytes(folder / "mesh.ply", ply_bytes(*_mesh(measured, terrain)))
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        points=samples.points.astype(np.float32),
        normals=samples.normals.astype(np.float32),
        solid=samples.solid,
        seen=samples.seen,
    )
    write_bytes(folder / "samples.npz", buffer.getvalue())


def read_truth(folder: Path) -> tuple[dict[str, Any], Samples]:
    """truth.json and the samples of a folder that `write_truth` wrote."""
    path = folder / "samples.npz"
    if not path.is_file():
        raise RealsimError("no truth of a synthetic capture here", file=folder, expected="truth.json and samples.npz")
    data = read_npz(path)
    samples = Samples(data["points"].astype(float), data["normals"].astype(float), data["solid"], data["seen"])
    return read_json(folder / "truth.json"), samples


def _mesh(solids: list[Solid], terrain: Terrain) -> tuple[F64, NDArray[np.int64]]:
    """The solids and a rectangle of floor as one mesh."""
    low, high = terrain.bounds[0, :2] - FLOOR_MARGIN, terrain.bounds[1, :2] + FLOOR_MARGIN
    ring = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    parts = [(s.vertices, s.triangles) for s in solids]
    parts.append((np.column_stack([ring, np.full(4, terrain.floor_z)]), np.array([[0, 1, 2], [0, 2, 3]])))
    return merged(parts)
