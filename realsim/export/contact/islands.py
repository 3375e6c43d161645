"""What stands on the ground, one connected thing at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.export.contact.base import Geom, floor_around, floor_plane
from realsim.export.contact.columns import Columns, check_extent, columns
from realsim.export.contact.undersides import Walls, settle
from realsim.types import TerrainMesh

F64 = NDArray[np.float64]
CELL = 0.005  # metres
PIT = 0.015  # metres below the ground from which a plane will not do as floor


@dataclass(frozen=True)
class Island:
    """Connected columns of one layer, cut out of the grid."""

    corner: tuple[int, int]
    """Row and column of its first cell in the grid."""
    top: F64
    """(rows, columns) z, NaN outside the island."""
    under: F64
    """(rows, columns) z of its underside, the base where it stands on the ground; NaN outside."""


@dataclass(frozen=True)
class Terrain:
    """A mesh as islands on a floor."""

    grid: Columns
    islands: tuple[Island, ...]
    base: float
    """z on which the islands stand: the ground, or the bottom of the deepest pit."""
    floor: tuple[Geom, ...]
    tolerance: float
    """Metres by which the surface is uncertain, 3 to 7 mm."""
    narrowest: int
    """Cells: what is narrower is what the mesh makes of an edge, not a face of its own."""
    unseen_undersides: tuple[float, float]
    """m^2 of undersides that no camera saw: of those that follow the lower ends of side faces, and of those left as
    the mesh has them."""

    @property
    def statistics(self) -> dict[str, float]:
        """For the report: the grid, and what of the undersides is not measured."""
        follow, kept = self.unseen_undersides
        return {
            "cell_m": self.grid.cell,
            "unseen_undersides_at_side_faces_cm2": round(follow * 1e4, 1),
            "unseen_undersides_as_filled_cm2": round(kept * 1e4, 1),
        }


def terrain(mesh: TerrainMesh, ground_z: float, cell: float = CELL) -> Terrain:
    """Everything that rises from the ground; where the ground has pits, the ground itself is an island too."""
    check_extent(mesh)
    grid = columns(mesh, ground_z, cell)
    tolerance = float(np.clip(2 * (mesh.noise_m or 0.0), 0.003, 0.007))
    floor: tuple[Geom, ...] = (floor_plane(ground_z),)
    base = ground_z
    pits = _pits(grid, ground_z)
    if pits.any():
        base = float(grid.top[0][pits].min()) - PIT
        floor = floor_around(_extent(grid), ground_z)
    narrowest = max(3, 2 * int(np.ceil(mesh.resolution / cell)) - 1)
    walls = Walls(mesh)
    found: list[Island] = []
    areas = np.zeros(2)
    for layer in range(len(grid.top)):
        for island, unseen in _layer(grid, layer, base, tolerance):
            under, inferred = settle(grid, island.corner, island.top, island.under, unseen, base, narrowest, walls)
            found.append(Island(island.corner, island.top, under))
            areas += inferred
    guessed = (float(areas[0]), float(areas[1]))
    return Terrain(grid, tuple(found), base, floor, tolerance, narrowest, guessed)


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


def _layer(grid: Columns, layer: int, base: float, tolerance: float) -> list[tuple[Island, NDArray[np.bool_]]]:
    """[(island, cells whose underside no camera saw)] of one layer."""
    from scipy import ndimage

    top, bottom, seen = grid.top[layer], grid.bottom[layer], grid.bottom_seen[layer]
    solid = np.isfinite(top) & (top > base + 1.5 * tolerance)
    islands, _ = ndimage.label(solid, np.ones((3, 3)))
    rim = _rim(grid)
    out = []
    for k, place in enumerate(ndimage.find_objects(islands), start=1):
        inside = islands[place] == k
        z = np.where(inside, top[place], np.nan)
        size = float(inside.sum()) * grid.cell**2
        if is_speck(float(np.nanmax(z)) - base, size, bool((inside & rim[place]).any())):
            continue
        under = np.where(inside, np.maximum(bottom[place], base), np.nan)
        out.append((Island((place[0].start, place[1].start), z, under), inside & ~seen[place]))
    return out


def _rim(grid: Columns) -> NDArray[np.bool_]:
    """(rows, columns) what lies at most two cells from where the mesh ends."""
    from scipy import ndimage

    beyond = np.pad(~np.isfinite(grid.top[0]), 1, constant_values=True)
    return ndimage.binary_dilation(beyond, np.ones((5, 5)))[1:-1, 1:-1]


def is_speck(height: float, area: float, at_rim: bool = False) -> bool:
    """Whether a piece of surface is noise on the floor: lower than 1 cm, below 2.5 cm and smaller than half a foot,
    or (where a scan ends, in the shadow of things) below 4 cm and smaller than a foot."""
    if height < 0.01 or area < 3e-4:
        return True
    return (height < 0.04 and area < 1.2e-2) if at_rim else (height < 0.025 and area < 6e-3)
