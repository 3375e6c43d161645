"""`boxes`: oriented boxes, and prisms where a box does not fit, under every planar piece of the surface.

Every top face becomes solids with exactly that face: its outline drawn down to the ground, or to the underside where
there is one. Gaps stay open, edges stay sharp, and what MuJoCo has to collide are boxes and small convex prisms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_around, floor_plane
from realsim.export.contact.columns import Columns, check_extent, columns
from realsim.export.contact.outline import convex_parts, outlines
from realsim.export.contact.planes import SMALLEST, heights, segment, spread
from realsim.geometry import R_to_quat
from realsim.types import TerrainMesh

F64 = NDArray[np.float64]
CELL = 0.005  # metres
EDGE = 1.0  # cells by which outlines are simplified, and by which convex parts may bulge over them
DEPTH = 0.05  # metres that solids reach into the ground
THINNEST = 0.003  # metres
PIT = 0.015  # metres below the ground from which a plane will not do as floor


@dataclass(frozen=True)
class Prism:
    """A convex outline between two planes."""

    outline: F64
    """(M, 2) x y, counter-clockwise, metres."""
    top: F64
    """(M,) z at the corners."""
    bottom: F64
    """(M,) z at the corners."""


def boxes(mesh: TerrainMesh, ground_z: float, config: SceneConfig) -> ContactModel:
    """Planar pieces of the surface as boxes and prisms, on an infinite floor.

    Where the ground has pits, it is made of prisms like everything else, with a floor around it.
    """
    check_extent(mesh)
    grid = columns(mesh, ground_z, CELL)
    tolerance = max(0.003, 2 * (mesh.noise_m or 0.0) if mesh.noise_m and mesh.noise_m < 0.004 else 0.003)
    floor: tuple[Geom, ...] = (floor_plane(ground_z),)
    base = ground_z
    pits = _pits(grid, ground_z)
    if pits.any():
        base = float(grid.top[0][pits].min()) - PIT
        floor = floor_around(_extent(grid), ground_z)
    prisms = [p for layer in range(len(grid.top)) for p in _layer(grid, layer, base, tolerance)]
    return as_contact("boxes", prisms, floor, {"cell_m": grid.cell, "plane_tolerance_m": tolerance})


def as_contact(name: str, prisms: list[Prism], floor: tuple[Geom, ...], statistics: dict) -> ContactModel:
    """Geoms of prisms: a box where that is within 5 mm of it, else a convex mesh of its corners."""
    geoms, assets = list(floor), []
    for k, prism in enumerate(prisms):
        box = _as_box(f"part_{k}", prism)
        if box is None:
            corners = np.concatenate(
                [np.column_stack([prism.outline, prism.top]), np.column_stack([prism.outline, prism.bottom])]
            )
            assets.append(Asset.of_points(f"part_{k}", corners))
            box = Geom(f"part_{k}", "mesh", asset=f"part_{k}")
        geoms.append(box)
    return ContactModel(name, tuple(geoms), tuple(assets), statistics | {"parts": len(prisms)})


def _pits(grid: Columns, ground_z: float) -> NDArray[np.bool_]:
    """(rows, columns) what lies clearly below the ground over at least 100 cm^2 in one piece, and not in threads: a
    few stray cells at the rim of a scan are no pit."""
    from scipy import ndimage

    low = np.isfinite(grid.top[0]) & (grid.top[0] < ground_z - PIT)
    pieces, count = ndimage.label(ndimage.binary_opening(low, np.ones((5, 5))))
    sizes = np.bincount(pieces.ravel(), minlength=count + 1) * grid.cell**2
    sizes[0] = 0
    return (sizes > 0.01)[pieces]


def _extent(grid: Columns) -> F64:
    rows, cols = grid.top.shape[1:]
    half = grid.cell / 2
    return np.stack([grid.lower - half, grid.lower + grid.cell * np.array([cols - 1, rows - 1]) + half])


def _layer(grid: Columns, layer: int, base: float, tolerance: float) -> list[Prism]:
    """Prisms of one layer of intervals, island by island."""
    from scipy import ndimage

    top, bottom = grid.top[layer], grid.bottom[layer]
    solid = np.isfinite(top) & (top > base + 1.5 * tolerance)
    islands, _ = ndimage.label(solid, np.ones((3, 3)))
    out = []
    for k, place in enumerate(ndimage.find_objects(islands), start=1):
        inside = islands[place] == k
        z = np.where(inside, top[place], np.nan)
        if _speck(float(np.nanmax(z)) - base, float(inside.sum()) * grid.cell**2):
            continue
        under = np.where(inside, np.maximum(bottom[place], base), np.nan)
        # A scanned wall is never quite upright: what hangs over by a cell or two is wall, not underside.
        hangs = ndimage.binary_opening(inside & (under > base), np.ones((3, 3)))
        under[inside & ~hangs] = base
        out += _island(grid, (place[0].start, place[1].start), z, under, base, tolerance)
    return out


def _speck(height: float, area: float) -> bool:
    """Whether an island is noise on the floor: lower than 1 cm, or below 2.5 cm and smaller than half a foot."""
    return height < 0.01 or area < 3e-4 or (height < 0.025 and area < 6e-3)


def _island(grid: Columns, corner: tuple[int, int], z: F64, under: F64, base: float, tolerance: float) -> list[Prism]:
    inside = np.isfinite(z)
    tops, top_planes = segment(z, grid.cell, tolerance)
    raised = inside & (under > base)
    bottoms, bottom_planes = segment(np.where(raised, under, np.nan), grid.cell, tolerance)
    # Plane 0 of the undersides is the ground.
    bottoms = np.where(raised, np.where(bottoms >= 0, bottoms + 1, -1), np.where(inside, 0, -1))
    bottom_planes = np.concatenate([[[0.0, 0.0, base]], bottom_planes])
    top_cost = np.array([np.abs(z - heights(p, z.shape)) for p in top_planes])
    tops = spread(tops, inside, top_cost, np.abs(z - base))
    inside &= tops >= 0
    bottom_cost = np.array([np.abs(under - heights(p, z.shape)) for p in bottom_planes])
    bottoms = spread(np.where(inside, bottoms, -1), inside, bottom_cost)
    pairs = np.where(inside & (bottoms >= 0), tops * len(bottom_planes) + bottoms, -1)
    pairs = _without_crumbs(pairs, len(bottom_planes), top_cost, bottom_cost)
    out = []
    for pair in np.unique(pairs[pairs >= 0]):
        t, b = divmod(int(pair), len(bottom_planes))
        here = pairs == pair
        rise = min(float(np.hypot(*top_planes[t][:2])) / 2, THINNEST)  # from a cell's centre to the region's edge
        limits = float(z[here].max()) + rise, float(under[here].min()) - rise
        for part in convex_parts(outlines(here, EDGE), EDGE):
            prism = _prism(grid, corner, part, top_planes[t], None if b == 0 else bottom_planes[b], base, limits)
            out.append(prism)
    return out


def _without_crumbs(pairs: NDArray[np.int64], width: int, top_cost: F64, bottom_cost: F64) -> NDArray[np.int64]:
    """Pieces of fewer than SMALLEST cells go to the neighbour that suits them best."""
    from scipy import ndimage

    names = np.unique(pairs[pairs >= 0])
    index = np.searchsorted(names, pairs)
    labels = np.where(pairs >= 0, index, -1)
    for k in range(len(names)):
        pieces, count = ndimage.label(labels == k)
        sizes = np.bincount(pieces.ravel(), minlength=count + 1)
        sizes[0] = SMALLEST
        labels[(sizes < SMALLEST)[pieces]] = -1
    if not len(names):
        return pairs
    cost = np.array([np.nan_to_num(top_cost[n // width]) + np.nan_to_num(bottom_cost[n % width]) for n in names])
    labels = spread(labels, pairs >= 0, cost)
    return np.where(labels >= 0, names[np.maximum(labels, 0)], -1)


def _prism(
    grid: Columns,
    corner: tuple[int, int],
    part: F64,
    top: F64,
    bottom: F64 | None,
    base: float,
    limits: tuple[float, float],
) -> Prism:
    """From (row, column) within an island to metres; turned counter-clockwise in x y.

    `limits` are the highest top and the lowest underside of the region: where its outline leaves its cells by a few
    millimetres, a steep plane would stand out as a spike.
    """
    row, column = part[:, 0], part[:, 1]
    z_top = top[0] * column + top[1] * row + top[2]
    z_bottom = np.full(len(part), base - DEPTH) if bottom is None else bottom[0] * column + bottom[1] * row + bottom[2]
    z_top = np.minimum(z_top, limits[0])
    if bottom is not None:
        z_bottom = np.maximum(z_bottom, limits[1])
    z_bottom = np.minimum(z_bottom, z_top - THINNEST)
    xy = grid.xy(row + corner[0], column + corner[1])
    return Prism(xy[::-1], z_top[::-1], z_bottom[::-1])


def _as_box(name: str, prism: Prism, tolerance: float = 0.005) -> Geom | None:
    """The box of a prism whose outline is a rectangle and whose top is level, both within `tolerance` metres."""
    centre, axes, half = _rectangle(prism.outline)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    if not all(_distance(prism.outline, centre + s * half @ axes) < tolerance for s in signs):
        return None
    A = np.column_stack([prism.outline - centre, np.ones(len(prism.outline))])
    a, b, top = np.linalg.lstsq(A, prism.top, rcond=None)[0]
    _, _, bottom = np.linalg.lstsq(A, prism.bottom, rcond=None)[0]
    height = top - bottom
    if float(np.hypot(a, b)) * height > tolerance:
        return None  # its sides would lean out
    if np.ptp(prism.bottom) > 2 * tolerance and np.ptp(prism.top - prism.bottom) > tolerance:
        return None
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    u = np.array([*axes[0], a * axes[0, 0] + b * axes[0, 1]])
    u /= np.linalg.norm(u)
    rotation = np.stack([u, np.cross(normal, u), normal], 1)
    middle = np.array([*centre, top]) - normal * height / 2
    quat = R_to_quat(rotation)
    return Geom(
        name,
        "box",
        (float(middle[0]), float(middle[1]), float(middle[2])),
        (float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3])),
        (float(half[0]), float(half[1]), float(height / 2)),
    )


def _rectangle(outline: F64) -> tuple[F64, F64, F64]:
    """Smallest rectangle around a convex outline: (centre (2,), axes (2, 2) as rows, half sizes (2,))."""
    best: tuple[float, F64, F64, F64] | None = None
    for side in np.roll(outline, -1, axis=0) - outline:
        length = float(np.linalg.norm(side))
        if length < 1e-9:
            continue
        u = side / length
        axes = np.array([u, [-u[1], u[0]]])
        along = outline @ axes.T
        low, high = along.min(0), along.max(0)
        size = float((high - low).prod())
        if best is None or size < best[0] - 1e-12:
            best = size, (low + high) / 2 @ axes, axes, (high - low) / 2
    assert best is not None
    return best[1], best[2], best[3]


def _distance(outline: F64, point: F64) -> float:
    """Distance of a point from an outline's nearest side."""
    a, b = outline, np.roll(outline, -1, axis=0)
    side = b - a
    t = np.clip(((point - a) * side).sum(1) / np.maximum((side**2).sum(1), 1e-18), 0, 1)
    return float(np.linalg.norm(a + t[:, None] * side - point, axis=1).min())
