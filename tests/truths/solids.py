"""Ten terrains made of exact solids, for measuring contact geometry: closed, deterministic, metres, floor at z = 0.

Every terrain has a platform of 0.8 m a side at the origin for a robot to stand on, and the floor as one open sheet.
"""

from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from realsim.core.types import MeshQuality, TerrainMesh

FOOT = 0.05  # metres that solids reach below the floor
PLATFORM = 0.35


def block(x: float, y: float, sx: float, sy: float, top: float, bottom: float = -FOOT, yaw: float = 0.0) -> Manifold:
    """A box between two heights, turned by `yaw` degrees about its middle."""
    return Manifold.cube([sx, sy, top - bottom], True).rotate([0, 0, yaw]).translate([x, y, (top + bottom) / 2])


def hull(points: list[list[float]]) -> Manifold:
    return Manifold.hull_points(np.array(points, float))


def stakes() -> list[Manifold]:
    rng = np.random.default_rng(1)
    return [
        block(0.75 + 0.4 * (k // 2), 0.17 * (-1) ** k, 0.17, 0.15, rng.uniform(0.2, 0.36), yaw=rng.uniform(-30, 30))
        for k in range(12)
    ]


def beams() -> list[Manifold]:
    raised = [block(2.0, -0.2, 0.9, 0.1, 0.3, 0.22, yaw=8)]
    posts = [block(2.0 + s * 0.38, -0.2 + s * 0.053, 0.08, 0.1, 0.25, yaw=8) for s in (-1, 1)]
    return [block(1.1, 0.0, 1.2, 0.08, 0.3, yaw=-5), block(2.0, 0.25, 0.9, 0.12, 0.2, yaw=12), *raised, *posts]


def wedges() -> list[Manifold]:
    def wedge(x: float, length: float, height: float, yaw: float) -> Manifold:
        profile = [[-length / 2, -FOOT], [length / 2, -FOOT], [length / 2, height], [-length / 2, 0.0]]
        side = Manifold.extrude(CrossSection([profile]), 0.5).translate([0, 0, -0.25]).rotate([90, 0, 0])
        return side.rotate([0, 0, yaw]).translate([x, 0, 0])

    return [wedge(0.85, 0.6, 0.3, 0), wedge(1.65, 0.6, 0.16, 170), wedge(2.4, 0.5, 0.25, 35)]


def trapezoids() -> list[Manifold]:
    def frustum(x: float, low: float, high: float, height: float) -> Manifold:
        rings = [[[sx * w, sy * w * 1.2, z] for sx in (-1, 1) for sy in (-1, 1)] for w, z in ((low, 0), (high, height))]
        feet = [[a, b, -FOOT] for a, b, _ in rings[0]]
        return hull(rings[0] + rings[1] + feet).translate([x, 0, 0])

    return [frustum(0.9, 0.3, 0.12, 0.3), frustum(1.6, 0.25, 0.2, 0.35), frustum(2.3, 0.28, 0.08, 0.2)]


def overhang() -> list[Manifold]:
    return [block(1.0, 0, 0.2, 0.3, 0.4), block(1.15, 0, 0.6, 0.5, 0.4, 0.32), block(2.0, 0, 0.3, 0.3, 0.25)]


def arch() -> list[Manifold]:
    hole = Manifold.cylinder(1.0, 0.22, 0.22, 96, True).rotate([90, 0, 0]).translate([1.3, 0, 0])
    return [block(1.3, 0, 0.7, 0.4, 0.32) - hole]


def stairs() -> list[Manifold]:
    return [block(0.7 + 0.28 * k, 0, 0.28, 0.8, PLATFORM - 0.05 - 0.06 * k) for k in range(5)]


def thin_plate() -> list[Manifold]:
    legs = [block(1.2 + 0.3 * a, 0.2 * b, 0.04, 0.04, 0.255) for a in (-1, 1) for b in (-1, 1)]
    return [block(1.2, 0, 0.7, 0.5, 0.27, 0.25), *legs, block(2.1, 0, 0.5, 0.5, 0.02)]


def tilted_stake() -> list[Manifold]:
    def stake(x: float, tilt: list[float]) -> Manifold:
        whole = Manifold.cube([0.18, 0.18, 1.0], True).rotate(tilt).translate([x, 0, 0])
        return whole.trim_by_plane([0, 0, 1.0], -FOOT)

    return [stake(0.9, [0, 12, 20]), stake(1.5, [15, -8, 0]), stake(2.1, [0, 0, 45])]


def circle_of_wedges() -> list[Manifold]:
    out = []
    for k in range(8):
        corners = [(0.18, -20), (0.55, -20), (0.55, 20), (0.18, 20)]
        flat = [[r * np.cos(np.radians(a)), r * np.sin(np.radians(a))] for r, a in corners]
        top = [[x, y, 0.1 + 0.35 * (x - 0.18)] for x, y in flat]
        feet = [[x, y, -FOOT] for x, y in flat]
        out.append(hull(top + feet).rotate([0, 0, 45 * k]).translate([1.3, 0, 0]))
    return out


TERRAINS: dict[str, Callable[[], list[Manifold]]] = {
    f.__name__: f
    for f in (stakes, beams, wedges, trapezoids, overhang, arch, stairs, thin_plate, tilted_stake, circle_of_wedges)
}


def terrain(name: str) -> TerrainMesh:
    """The union of a terrain's solids with the floor's sheet; `stakes`, `beams`, ... see TERRAINS."""
    solid = Manifold()
    for part in [block(0, 0, 0.8, 0.8, PLATFORM), *TERRAINS[name]()]:
        solid += part
    return with_floor(solid)


def with_floor(solid: Manifold, margin: float = 0.5) -> TerrainMesh:
    mesh = solid.to_mesh64() if hasattr(solid, "to_mesh64") else solid.to_mesh()
    vertices = np.asarray(mesh.vert_properties, float)[:, :3]
    triangles = np.asarray(mesh.tri_verts, np.int32)
    sheet, faces = _sheet(vertices.min(0)[:2] - margin, vertices.max(0)[:2] + margin)
    triangles = np.concatenate([triangles, faces + len(vertices)]).astype(np.int32)
    vertices = np.concatenate([vertices, sheet])
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, 2, None)
    return TerrainMesh(vertices, triangles, None, np.zeros(len(triangles), bool), quality, "solids", 0.0)


def _sheet(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    corners = [[*lower, 0], [upper[0], lower[1], 0], [*upper, 0], [lower[0], upper[1], 0]]
    return np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def grid_mesh(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray], size: float, cells: int
) -> tuple[np.ndarray, np.ndarray]:
    """An open sheet over a square."""
    t = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = np.meshgrid(t, t)
    n = cells + 1
    a = (np.arange(cells)[:, None] * n + np.arange(cells)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])
    return np.column_stack([x.ravel(), y.ravel(), height(x, y).ravel()]), faces
