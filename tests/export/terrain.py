"""Small terrains for the export tests: exact solids on a floor, in the simulation frame."""

import numpy as np
import trimesh

from realsim.core.types import AlignedScene, Gravity, MeshQuality, Platform, Scan, TerrainMesh

GROUND = -0.3


def terrain_mesh(solids: list[trimesh.Trimesh], *, colors: bool = True) -> TerrainMesh:
    """Solids and a floor at GROUND as one open mesh; the floor's last two triangles are marked as invented."""
    lower = np.min([s.bounds[0] for s in solids], 0)[:2] - 0.3
    upper = np.max([s.bounds[1] for s in solids], 0)[:2] + 0.3
    corners = [[*lower, GROUND], [upper[0], lower[1], GROUND], [*upper, GROUND], [lower[0], upper[1], GROUND]]
    floor = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    whole = trimesh.util.concatenate([*solids, floor])
    vertices, triangles = np.asarray(whole.vertices), np.asarray(whole.faces, np.int32)
    invented = np.zeros(len(triangles), bool)
    invented[-2:] = True
    rgb = (np.clip((vertices - vertices.min(0)) / np.ptp(vertices, 0), 0, 1) * 255).astype(np.uint8)
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, len(solids), None)
    return TerrainMesh(vertices, triangles, rgb if colors else None, invented, quality, "test", 0.01)


def box(x: float, y: float, sx: float, sy: float, top: float) -> trimesh.Trimesh:
    """A box from GROUND to `top` about (x, y)."""
    mesh = trimesh.creation.box([sx, sy, top - GROUND])
    mesh.apply_translation([x, y, (top + GROUND) / 2])
    return mesh.subdivide()


def platform(x: float, y: float, size: float, top: float, role: str = "platform") -> Platform:
    outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 + [x, y]
    return Platform(np.array([x, y, top]), np.array([size, size, top - GROUND]), 0.0, size**2, outline, role)


def two_platforms() -> tuple[AlignedScene, TerrainMesh]:
    """A start platform at the origin, a goal 5 cm higher two metres ahead, a low step between."""
    mesh = terrain_mesh([box(0, 0, 0.8, 0.8, 0.0), box(2, 0, 0.8, 0.8, 0.05), box(1, 0.1, 0.4, 0.3, -0.2)])
    return scene(mesh, (platform(0, 0, 0.8, 0.0, "start"), platform(2, 0, 0.8, 0.05, "goal"))), mesh


def scene(mesh: TerrainMesh, platforms: tuple[Platform, ...]) -> AlignedScene:
    from pathlib import Path

    gravity = Gravity(np.array([0, 0, 1.0]), -GROUND, 0.1, 0.001, 1000, "test")
    bounds = np.stack([mesh.vertices.min(0), mesh.vertices.max(0)])
    scan = Scan(Path("test.ply"), "test", mesh.vertices)
    return AlignedScene(np.eye(4), gravity, GROUND, platforms, bounds, scan=scan)
