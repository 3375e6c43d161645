"""An island as prisms: a solid under every planar piece of its top.

A top with several undersides (the seat of a chair, the deck of an arch) is one solid as thick as its thinnest place,
and what reaches farther down hangs below it. Cut into a solid for every underside it would have seams that feet land
on, and a foot would touch several parts at once: on an arch, a step took seven times as long as on a plane.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64
from realsim.export.contact.islands import Island, Terrain
from realsim.export.contact.outline import convex_parts, outlines
from realsim.export.contact.planes import SMALLEST, Misfit, Window, from_corner, heights, misfit, segment, spread
from realsim.export.contact.prisms import Prism

DEPTH = 0.05  # metres that solids reach into the ground
THINNEST = 0.003  # metres
THINNEST_DECK = 0.02  # metres
COVER = 0.02  # metres below the top of a deck at which begins what carries it: out of reach of what lands on the deck
LEDGE = 0.01  # metres that something reaches below a deck; less is the deck's own underside
LOST = 0.02  # metres that a ledge lies off the plane beside it
EDGE = 1.0  # cells by which outlines are simplified
BULGE = 1.5  # cells by which convex parts may bulge over them


@dataclass(frozen=True)
class PlanarIsland:
    """An island described by planes."""

    prisms: tuple[Prism, ...]
    region: tuple[int, ...]
    """Which piece of the island, of one top and one underside, each prism is a part of."""
    misfit: float
    """95th percentile of the distance between the island's top and its planes, metres; rounded edges do not count. inf
    where it is not made of planes at all, and has no prisms."""


@dataclass(frozen=True)
class _Region:
    """Cells of an island under one plane, and over one or the ground."""

    place: Window
    here: NDArray[np.bool_]
    """(rows, columns) of that window."""
    top: F64
    """(3,) a b c in cells of the island."""
    bottom: F64 | None
    """The same; None: down into the ground."""
    cover: float = 0.0
    """Metres below the surface at which it begins."""

    def prisms(self, whole: Terrain, island: Island, z: F64, under: F64) -> list[Prism]:
        """The convex prisms that it is made of."""
        height = float(z[self.place][self.here].max()) - self.cover
        rise = min(float(np.hypot(*self.top[:2])) / 2, THINNEST)  # from a cell's centre to the region's edge
        limits = height + rise, float(under[self.place][self.here].min()) - rise
        corner = np.array([self.place[0].start, self.place[1].start])
        parts = convex_parts(outlines(self.here, EDGE), BULGE)
        return [_prism(whole, island, corner + part, self.top, self.bottom, limits) for part in parts]


def planar(whole: Terrain, island: Island) -> PlanarIsland:
    """The prisms under every planar piece of an island's top, and how well planes describe it."""
    from scipy import ndimage

    z, under, base, cell = island.top, island.under, whole.base, whole.grid.cell
    inside = np.isfinite(z)
    raised = inside & (under > base)
    upper = segment(z, cell, whole.tolerance, whole.narrowest)
    lower = upper and segment(np.where(raised, under, np.nan), cell, whole.tolerance, whole.narrowest)
    if not upper or not lower:
        return PlanarIsland((), (), np.inf)
    if 2 * raised.sum() > inside.sum():
        lower = _of_all(raised, under, *lower)
    (tops, top_planes), (bottoms, bottom_planes) = upper, lower
    # Plane 0 of the undersides is the ground.
    bottoms = np.where(raised, np.where(bottoms >= 0, bottoms + 1, -1), np.where(inside, 0, -1))
    bottom_planes = np.concatenate([[[0.0, 0.0, base]], bottom_planes])
    if not len(top_planes):
        return PlanarIsland((), (), 0.0)
    top_cost, bottom_cost = misfit(z, top_planes), misfit(under, bottom_planes)
    # What is farther from the rim than an edge is wide is no edge: it stays, however badly the planes suit it.
    depth = ndimage.distance_transform_cdt(np.pad(inside, 1), "chessboard")[1:-1, 1:-1]
    tops = spread(tops, inside, top_cost, np.where(depth <= whole.narrowest, np.abs(z - base), np.inf))
    tops, top_planes = _with_ledges(z, tops, top_planes, top_cost(tops))
    top_cost = misfit(z, top_planes)
    inside &= tops >= 0
    bottoms = spread(np.where(inside, bottoms, -1), inside, bottom_cost)
    pairs = np.where(inside & (bottoms >= 0), tops * len(bottom_planes) + bottoms, -1)
    pairs = _without_crumbs(pairs, len(bottom_planes), top_cost, bottom_cost)
    inner = ndimage.binary_erosion(inside, iterations=whole.narrowest // 2)
    inner = inner if inner.any() else inside
    out: list[list[Prism]] = []
    off = np.zeros(0)
    width = len(bottom_planes)
    places = ndimage.find_objects(np.where(pairs >= 0, pairs // width, -1) + 1)
    for t, place in enumerate(places):
        if place is None:
            continue
        pair, height, below = pairs[place], z[place], under[place]
        of_top = (pair >= 0) & (pair // width == t)
        level = heights(from_corner(top_planes[t], place), height.shape)
        regions = [
            _Region(place, pair == k, top_planes[t], bottom_planes[k % width] if k % width else None)
            for k in np.unique(pair[of_top])
        ]
        if len(regions) > 1:
            regions = _decked(regions, of_top, level - below)
        for region in regions:
            out.append([prism for prism in region.prisms(whole, island, z, under) if not prism.flat])
        steep = np.hypot(1, np.hypot(*top_planes[t][:2]) / cell)
        off = np.append(off, np.abs(height - level)[of_top & inner[place]] / steep)
    prisms = tuple(prism for region in out for prism in region)
    of = tuple(k for k, region in enumerate(out) for _ in region)
    return PlanarIsland(prisms, of, float(np.percentile(off, 95)) if len(off) else 0.0)


def _decked(regions: list[_Region], of_top: NDArray[np.bool_], thick: F64) -> list[_Region]:
    """The regions of one top as a deck and what hangs below it, where the top is thick enough everywhere.

    Args:
        of_top: (rows, columns) cells of all of them. thick: (rows, columns) metres from the top to the underside.
    """
    deck = float(np.percentile(thick[of_top], 1))
    if deck < THINNEST_DECK:
        return regions
    first = regions[0]
    down, cover = np.array([0.0, 0.0, 1.0]), min(COVER, deck / 2)
    hanging = [r for r in regions if np.percentile(thick[r.here], 99) > deck + LEDGE]
    return [_Region(first.place, of_top, first.top, first.top - deck * down)] + [
        replace(r, top=r.top - cover * down, cover=cover) for r in hanging
    ]


def _of_all(
    raised: NDArray[np.bool_], under: F64, labels: NDArray[np.int64], planes: F64
) -> tuple[NDArray[np.int64], F64]:
    """(labels, planes) of what floats, with a level plane for every piece of its underside that has none, being too
    small or too round: by a single column whose underside a ray missed, it would be a pillar down to the ground."""
    from scipy import ndimage

    pieces, count = ndimage.label(raised)
    bare = np.setdiff1d(np.arange(1, count + 1), pieces[labels >= 0])
    if not len(bare):
        return labels, planes
    new = np.full(count + 1, -1)
    new[bare] = len(planes) + np.arange(len(bare))
    level = np.zeros((len(bare), 3))
    level[:, 2] = ndimage.median(under, pieces, bare)
    return np.where(new[pieces] >= 0, new[pieces], labels), np.concatenate([planes, level])


def _with_ledges(z: F64, labels: NDArray[np.int64], planes: F64, off: F64) -> tuple[NDArray[np.int64], F64]:
    """(labels, planes) with level planes for ledges that were too narrow to make one and would be lifted or sunk, by
    `off` metres, to the plane beside them. On a ledge, most neighbours are as high; on a wall, few."""
    from scipy import ndimage

    height, reach = np.pad(z, 1, constant_values=np.nan), range(3)
    rows, columns = z.shape
    around = [height[r : r + rows, c : c + columns] for r in reach for c in reach]
    level = sum((np.abs(other - z) < LOST / 2).astype(int) for other in around) > 5  # the cell itself is one
    pieces, _ = ndimage.label((labels >= 0) & level & (off > LOST))
    labels, out = labels.copy(), list(planes)
    for k, place in enumerate(ndimage.find_objects(pieces), start=1):
        here = pieces[place] == k
        if here.sum() >= SMALLEST and np.ptp(z[place][here]) < 2 * LOST:
            labels[place][here] = len(out)
            out.append(np.array([0.0, 0.0, float(np.median(z[place][here]))]))
    return labels, np.array(out).reshape(-1, 3)


def _without_crumbs(pairs: NDArray[np.int64], width: int, top_cost: Misfit, bottom_cost: Misfit) -> NDArray[np.int64]:
    """Pieces of fewer than SMALLEST cells go to the neighbour that suits them best, and so do those one cell wide: they
    have no outline, and would be a slot."""
    from scipy import ndimage

    labels = pairs.copy()
    for name, place in enumerate(ndimage.find_objects(pairs + 1)):
        if place is None:
            continue
        pieces, count = ndimage.label(pairs[place] == name)
        wide = ndimage.binary_opening(pieces > 0, np.ones((2, 2)))
        crumb = np.bincount(pieces.ravel(), minlength=count + 1) < SMALLEST
        crumb |= np.bincount(pieces[wide], minlength=count + 1) == 0
        crumb[0] = False
        labels[place][crumb[pieces]] = -1

    def cost(pair: NDArray[np.int64], *at: Any) -> F64:
        top, bottom = np.divmod(np.maximum(pair, 0), width)
        return np.nan_to_num(top_cost(top, *at)) + np.nan_to_num(bottom_cost(bottom, *at))

    return spread(labels, pairs >= 0, cost)


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
