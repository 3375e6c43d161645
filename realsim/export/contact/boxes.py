"""`boxes`: oriented boxes, and prisms where a box does not fit, under every planar piece of the surface.

Every top face becomes solids with exactly that face: its outline drawn down to the ground, or to the underside where
there is one. Gaps stay open, edges stay sharp, and what MuJoCo has to collide are boxes and small convex prisms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel
from realsim.export.contact.islands import Island, Terrain, terrain
from realsim.export.contact.outline import convex_parts, outlines
from realsim.export.contact.planes import SMALLEST, heights, segment, spread
from realsim.export.contact.prisms import Prism, as_contact
from realsim.types import TerrainMesh

F64 = NDArray[np.float64]
DEPTH = 0.05  # metres that solids reach into the ground
THINNEST = 0.003  # metres
EDGE = 1.0  # cells by which outlines are simplified, and by which convex parts may bulge over them


def boxes(mesh: TerrainMesh, ground_z: float, config: SceneConfig) -> ContactModel:
    """Planar pieces of the surface as boxes and prisms, on an infinite floor (on prisms too where it has pits)."""
    whole = terrain(mesh, ground_z)
    prisms = [prism for island in whole.islands for prism in island_prisms(whole, island)[0]]
    statistics = {"cell_m": whole.grid.cell, "plane_tolerance_m": whole.tolerance}
    return as_contact("boxes", prisms, whole.floor, statistics)


def island_prisms(whole: Terrain, island: Island) -> tuple[list[Prism], float]:
    """(prisms of an island, 95th percentile of the distance in metres between its top and its planes)."""
    z, under, base, cell = island.top, island.under, whole.base, whole.grid.cell
    inside = np.isfinite(z)
    tops, top_planes = segment(z, cell, whole.tolerance)
    raised = inside & (under > base)
    bottoms, bottom_planes = segment(np.where(raised, under, np.nan), cell, whole.tolerance)
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
    out: list[Prism] = []
    off = np.zeros(0)
    for pair in np.unique(pairs[pairs >= 0]):
        t, b = divmod(int(pair), len(bottom_planes))
        here = pairs == pair
        rise = min(float(np.hypot(*top_planes[t][:2])) / 2, THINNEST)  # from a cell's centre to the region's edge
        limits = float(z[here].max()) + rise, float(under[here].min()) - rise
        for part in convex_parts(outlines(here, EDGE), EDGE):
            out.append(_prism(whole, island, part, top_planes[t], None if b == 0 else bottom_planes[b], limits))
        off = np.concatenate([off, top_cost[t][here] / np.hypot(1, np.hypot(*top_planes[t][:2]) / cell)])
    return out, float(np.percentile(off, 95)) if len(off) else 0.0


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
    whole: Terrain, island: Island, part: F64, top: F64, bottom: F64 | None, limits: tuple[float, float]
) -> Prism:
    """From (row, column) within an island to metres; turned counter-clockwise in x y.

    `limits` are the highest top and the lowest underside of the region: where its outline leaves its cells by a few
    millimetres, a steep plane would stand out as a spike.
    """
    row, column = part[:, 0], part[:, 1]
    z_top = top[0] * column + top[1] * row + top[2]
    z_bottom = (
        np.full(len(part), whole.base - DEPTH) if bottom is None else bottom[0] * column + bottom[1] * row + bottom[2]
    )
    z_top = np.minimum(z_top, limits[0])
    if bottom is not None:
        z_bottom = np.maximum(z_bottom, limits[1])
    z_bottom = np.minimum(z_bottom, z_top - THINNEST)
    xy = whole.grid.xy(row + island.corner[0], column + island.corner[1])
    return Prism(xy[::-1], z_top[::-1], z_bottom[::-1])
