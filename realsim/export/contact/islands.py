"""Connected objects on the ground."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across, sampled, used
from realsim.core.types import F64, TerrainMesh
from realsim.export.contact.base import Geom, floor_around, floor_plane
from realsim.export.contact.columns import NARROW, Columns, check_extent, columns
from realsim.export.contact.merge import ADDS
from realsim.export.contact.probe import Reference
from realsim.export.contact.undersides import Walls, settle

CELL = 0.005  # metres; of a mesh that is exact as fine as...
FINEST = 0.0005  # metres; and...
MOST_FINE = (
    1_000_000  # cells, unless they are of CELL or more (set by hand for memory; its gain is not measured); and...
)
WITHIN = 4.0  # cells in its thinnest wall (a round post of 4 has the 12 that make a plane); at least...
THROUGH = 3.0  # cells by which a hull may stand out where parts are made one, so no thin wall is filled: glasses of
# 2 and 3 mm have 0.6 % of heights off for 7.0 (16 parts for 8); a grating of 5 mm keeps 60 parts, and has 187 with 2
SHARE = 0.25  # ...this share of a reconstruction's resolution, below which there is nothing to find
THINNER, SIDES = 2, 2000  # percent of the walls that may be thinner (set on posts of 1.5 cm in a place of 2 m; not
# measured on others), and places at which they are measured
PIT, NOISES = 0.015, 2.5  # metres below the ground, and times the noise, from which a plane will not do as floor; the
# second was set on a made corridor of 9 x 6 m whose floor is uneven by 5 mm, and holds on one of 35 x 21 m
PIT_AREA = 0.01  # m^2 that were measured: a smaller one is no pit; set by hand, less than a foot
RIM = 0.03  # metres beside a pit in which its walls come up to the ground
FINE, ROUGH = 0.003, 0.015
"""Metres that a plane may be off: of an exact mesh, and at most. The second was set on a rendered corridor of 4 x 2 m;
on three reconstructed captures, where it was not set, the p95 of contact stays within 0.1 mm."""
Window = tuple[slice, slice]


@dataclass(frozen=True)
class Island:
    """Connected columns of one layer, cut out of the grid."""

    corner: tuple[int, int]
    """Row and column of its first cell in the grid."""
    top: F64
    """(rows, columns) z, NaN outside the island."""
    under: F64
    """(rows, columns) z of its underside, the base where it stands on the ground; NaN outside."""
    top_seen: float = 1.0
    """Share of its top that was measured; a ceiling has none."""


@dataclass(frozen=True)
class Terrain:
    """A mesh as islands on a floor."""

    grid: Columns
    islands: tuple[Island, ...]
    base: float
    """z down to which islands reach: the ground, or the bottom of the deepest pit."""
    floor: tuple[Geom, ...]
    tolerance: float
    """Metres by which the surface is uncertain, FINE to ROUGH."""
    narrowest: int
    """Cells: what is narrower is what the mesh makes of an edge, not a face of its own."""
    unseen_undersides: tuple[float, float]
    """m^2 of undersides that no camera saw: of those that follow the lower ends of side faces, and of those left as
    the mesh has them."""

    @property
    def adds(self) -> float:
        """Metres by which a hull may stand out of the shape."""
        return min(THROUGH * self.grid.cell, self.tolerance / FINE * ADDS)

    @property
    def statistics(self) -> dict[str, float]:
        """For the report: the grid, and what of the undersides is not measured."""
        follow, kept = self.unseen_undersides
        return {
            "cell_m": self.grid.cell,
            "unseen_undersides_at_side_faces_cm2": round(follow * 1e4, 1),
            "unseen_undersides_as_filled_cm2": round(kept * 1e4, 1),
        }


def terrain(mesh: TerrainMesh, ground_z: float, cell: float | None = None) -> Terrain:
    """Everything that rises from the ground; about pits in the ground, the ground itself is an island too.

    Args:
        cell: metres between columns, at least; None: as fine as the mesh needs.
    """
    check_extent(mesh)
    if mesh.noise_m is None:  # made by hand: its long edges are exact
        size = np.ptp(used(mesh.vertices, mesh.triangles)[:, :2], axis=0)
        finest = max(FINEST, float(np.sqrt(size.prod() / MOST_FINE)))
        cell = cell or float(np.clip(_thinnest(mesh) / WITHIN, finest, CELL))
    else:
        cell = max(cell or CELL, SHARE * mesh.resolution)
    grid = columns(mesh, ground_z, cell)
    tolerance = float(np.clip(2 * (mesh.noise_m or 0.0), FINE, ROUGH))
    floor: tuple[Geom, ...] = (floor_plane(ground_z),)
    base = ground_z
    pits = _pits(grid, ground_z - max(PIT, NOISES * (mesh.noise_m or 0.0)))
    dug = np.zeros(pits.shape, bool)
    if pits.any():
        base = float(grid.lowest[pits].min()) - PIT
        holes = _holes(pits, round(RIM / cell))
        for hole in holes:
            dug[hole] = True
        floor = floor_around(np.array([_bounds(grid, hole) for hole in holes]), ground_z)
    level = np.where(dug, base, ground_z)
    narrowest = max(3, 2 * int(np.ceil(mesh.resolution / cell)) - 1)
    walls = Walls(mesh)
    found: list[Island] = []
    areas = np.zeros(2)
    for layer in range(len(grid.top)):
        for island, unseen in _layer(grid, layer, base, level, tolerance, narrowest, scan=mesh.noise_m is not None):
            under, inferred = settle(grid, island.corner, island.top, island.under, unseen, base, narrowest, walls)
            found.append(replace(island, under=under))
            areas += inferred
    guessed = (float(areas[0]), float(areas[1]))
    return Terrain(grid, tuple(found), base, floor, tolerance, narrowest, guessed)


def _thinnest(mesh: TerrainMesh) -> float:
    """Metres through the thinnest walls of a mesh; inf where none has a back."""
    points, of = sampled(mesh.vertices, mesh.triangles, SIDES, np.random.default_rng(0))
    normal = across(mesh.vertices, mesh.triangles[of])
    level = np.linalg.norm(normal[:, :2], axis=1)
    upright = level > np.abs(normal[:, 2])
    if not upright.any():
        return np.inf
    way = np.zeros((int(upright.sum()), 3))
    way[:, :2] = -normal[upright, :2] / level[upright, None]
    t, cosine, _ = Reference(mesh.vertices, mesh.triangles).cast(points[upright] + 1e-4 * way, way)
    through = t[np.isfinite(t) & (cosine > 0)]
    return float(np.percentile(through, THINNER)) if len(through) else np.inf


def _pits(grid: Columns, level: float) -> NDArray[np.bool_]:
    """(rows, columns) what lies below a level, in pieces of which at least 100 cm^2 were measured, and not
    in threads: a few stray cells at the rim of a scan are no pit, nor is the bottom that a mesh was closed with."""
    from scipy import ndimage

    low = np.isfinite(grid.lowest) & (grid.lowest < level)
    pieces, count = ndimage.label(ndimage.binary_opening(low, np.ones((5, 5))))
    sizes = np.bincount(pieces.ravel(), grid.lowest_seen.ravel(), minlength=count + 1) * grid.cell**2
    sizes[0] = 0
    return (sizes > PIT_AREA)[pieces]


def _holes(pits: NDArray[np.bool_], rim: int) -> list[Window]:
    """Windows of the grid that hold all pits, `rim` cells wider than they, and apart from each other."""
    from scipy import ndimage

    rows, columns = pits.shape
    pieces, _ = ndimage.label(pits)
    found: list[Window] = [
        (
            slice(max(r.start - rim, 0), min(r.stop + rim, rows)),
            slice(max(c.start - rim, 0), min(c.stop + rim, columns)),
        )
        for r, c in ndimage.find_objects(pieces)
    ]
    while True:
        covered = np.zeros(pits.shape, bool)
        for window in found:
            covered[window] = True
        merged: list[Window] = ndimage.find_objects(ndimage.label(covered, np.ones((3, 3)))[0])
        if len(merged) == len(found):
            return found
        found = merged


def _bounds(grid: Columns, window: Window) -> F64:
    """(2, 2) lower and upper x y of a window of the grid, metres."""
    rows, cols = window
    return grid.lower + grid.cell * (np.array([[cols.start, rows.start], [cols.stop, rows.stop]]) - 0.5)


def _layer(
    grid: Columns, layer: int, base: float, level: F64, tolerance: float, narrowest: int, *, scan: bool
) -> list[tuple[Island, NDArray[np.bool_]]]:
    """[(island, cells whose underside no camera saw)] of one layer; `level` (rows, columns) is the z of the floor below
    each cell, `base` in holes for pits and the ground elsewhere. Specks are noise of a `scan`; who makes a mesh by hand
    means its thin posts and low sills."""
    from scipy import ndimage

    top, bottom, seen = grid.top[layer], grid.bottom[layer], grid.bottom_seen[layer]
    solid = np.isfinite(top) & (top > level + 1.5 * tolerance)
    islands = _connected(solid, top, np.where(bottom > level, bottom, -np.inf), narrowest)
    rim = _rim(grid)
    out = []
    for k, place in enumerate(ndimage.find_objects(islands), start=1):
        inside = islands[place] == k
        z = np.where(inside, top[place], np.nan)
        size = float(inside.sum()) * grid.cell**2
        if scan and _is_speck(float(np.nanmax(z - level[place])), size, bool((inside & rim[place]).any())):
            continue
        under = np.where(inside, np.where(bottom[place] > level[place], bottom[place], base), np.nan)
        share = float(grid.top_seen[layer][place][inside].mean())
        out.append((Island((place[0].start, place[1].start), z, under, share), inside & ~seen[place]))
    return out


def _connected(solid: NDArray[np.bool_], top: NDArray[Any], under: NDArray[Any], narrowest: int) -> NDArray[np.int64]:
    """(rows, columns) number of the island that each cell belongs to, 0 where nothing is `solid`.

    Cells side by side are of one island if they meet in height too: what floats over a platform is not the platform's,
    or its underside, too small for a plane of its own, would go to what is beside it and become a pillar. A strip
    narrower than `narrowest` cells, beside what floats and as high, is a column of rays that missed the underside.

    Args:
        under: (rows, columns) z, -inf where a column stands on the ground.
    """
    from scipy import ndimage
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    hangs = solid & (under > -np.inf)
    if hangs.any():
        far, near = ndimage.distance_transform_cdt(~hangs, return_indices=True)
        beside = under[near[0], near[1]]
        as_high = (top > beside - NARROW) & (top < top[near[0], near[1]] + NARROW)
        missed = solid & ~hangs & (far < narrowest) & as_high
        missed &= ~ndimage.binary_opening(missed, np.ones((narrowest, narrowest)))
        under, hangs = np.where(missed, beside, under), hangs | missed
    # What stands on the ground always meets: a number for each cell only of what hangs.
    nodes, standing = ndimage.label(solid & ~hangs, np.ones((3, 3)))
    nodes[hangs] = standing + 1 + np.arange(hangs.sum())
    ends: list[NDArray[Any]] = [np.zeros((2, 0), int)]
    s = np.s_
    for a, b in (
        (s[:, :-1], s[:, 1:]),
        (s[:-1], s[1:]),
        (s[:-1, :-1], s[1:, 1:]),
        (s[:-1, 1:], s[1:, :-1]),
    ):
        pair = solid[a] & solid[b] & (hangs[a] | hangs[b])
        gap = np.maximum(under[a][pair], under[b][pair]) - np.minimum(top[a][pair], top[b][pair])
        ends.append(np.stack([nodes[a][pair], nodes[b][pair]])[:, gap < NARROW])
    one, other = np.concatenate(ends, 1)
    count = int(nodes.max()) + 1
    # Node 0, what is not solid, meets nothing and comes first.
    return connected_components(coo_array((np.ones(len(one), bool), (one, other)), (count, count)), False)[1][nodes]


def _rim(grid: Columns) -> NDArray[np.bool_]:
    """(rows, columns) what lies at most two cells from where the mesh ends."""
    from scipy import ndimage

    beyond = np.pad(~np.isfinite(grid.top[0]), 1, constant_values=True)
    return ndimage.binary_dilation(beyond, np.ones((5, 5)))[1:-1, 1:-1]


def _is_speck(height: float, area: float, at_rim: bool) -> bool:
    """Whether a piece of surface is noise on the floor: lower than 1 cm, below 2.5 cm and smaller than half a foot,
    or (where a scan ends, in the shadow of things) below 4 cm and smaller than a foot."""
    if height < 0.01 or area < 3e-4:
        return True
    return (height < 0.04 and area < 1.2e-2) if at_rim else (height < 0.025 and area < 6e-3)
