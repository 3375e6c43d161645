"""A mesh as columns: what is solid above each cell of a fine grid."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError
from realsim.core.meshes import across, used
from realsim.core.types import F32, F64, TerrainMesh
from realsim.export.contact.rays import Rays

MAX_CELLS = 4_000_000
AT_ONCE = 500_000  # cells: all rays of a large grid at once would take a gigabyte
MAX_LAYERS = 8
NARROW = 0.02  # metres: a gap lower than this is closed, nothing that matters fits in
SHEET = 0.01  # metres: the least that holds up what falls on it


@dataclass(frozen=True)
class Columns:
    """Solid intervals of every column, the topmost first."""

    lower: F64
    """(2,) x y of the centre of cell [0, 0], metres."""
    cell: float
    """Metres between cell centres."""
    top: F32
    """(L, rows, columns) z where interval l ends above; NaN where the column has fewer intervals."""
    top_seen: NDArray[np.bool_]
    """(L, rows, columns) whether that end above is a surface that was measured."""
    bottom: F32
    """(L, rows, columns) z where it ends below; -inf where it reaches the ground."""
    bottom_seen: NDArray[np.bool_]
    """(L, rows, columns) whether that end below is a surface that was measured, not one that was filled in."""

    @property
    def lowest(self) -> F32:
        """(rows, columns) z where the lowest interval ends above: the ground, where it was seen."""
        return np.take_along_axis(self.top, self._last, 0)[0]

    @property
    def lowest_seen(self) -> NDArray[np.bool_]:
        """(rows, columns) whether that is a surface that was measured."""
        return np.take_along_axis(self.top_seen, self._last, 0)[0]

    @property
    def _last(self) -> NDArray[np.int64]:
        return np.maximum(np.isfinite(self.top).sum(0, keepdims=True) - 1, 0)

    def xy(self, row: NDArray, column: NDArray) -> F64:
        """(..., 2) metres of (fractional) cell indices."""
        return self.lower + self.cell * np.stack([column, row], -1)


def columns(mesh: TerrainMesh, ground_z: float, cell: float) -> Columns:
    """Cast a ray down through every cell and count how deep it is inside the mesh.

    An upward facing triangle is a way in, a downward facing one a way out, so solids may overlap. A surface that is
    never left (a scan without an underside) is solid down to the ground; one that is left and was never entered (a
    ceiling, the underside of a tread whose top no camera saw) is a sheet SHEET thick.

    Args:
        ground_z: z of the ground; what lies at most 2 cm above it stands on it.
        cell: metres; coarsened where the grid would have more than MAX_CELLS cells.
    """
    named = used(mesh.vertices, mesh.triangles)
    lower, upper = named.min(0), named.max(0)
    cell = max(cell, float(np.sqrt((upper - lower)[:2].prod() / MAX_CELLS)))
    counts = np.maximum(np.ceil((upper - lower)[:2] / cell).astype(int), 1)
    origin = lower[:2] + ((upper - lower)[:2] - (counts - 1) * cell) / 2
    rays, strips = Rays(mesh.vertices, mesh.triangles), []
    rows = max(1, AT_ONCE // counts[0])
    for row in range(0, counts[1], rows):
        y, x = np.meshgrid(np.arange(row, min(row + rows, counts[1])), np.arange(counts[0]), indexing="ij")
        at = origin[0] + cell * x.ravel(), origin[1] + cell * y.ravel()
        ray, z, up, seen = crossings(mesh, *at, float(upper[2]) + 1, rays)
        top, bottom, above, below = _tidy(*_intervals(ray, z, up, x.size), ground_z)
        # Of -1: not seen; nor is the top of a sheet of which the underside was.
        made = top, np.append(seen & up, False)[above], bottom, np.append(seen, False)[below]
        strips.append([values.reshape(-1, *x.shape) for values in made])
    layers = max(len(strip[0]) for strip in strips)

    def joined(k: int, nothing: float) -> NDArray[Any]:
        below = [((0, layers - len(strip[k])), (0, 0), (0, 0)) for strip in strips]
        padded = [np.pad(strip[k], more, constant_values=nothing) for strip, more in zip(strips, below, strict=True)]
        return np.concatenate(padded, axis=1)

    return Columns(origin, cell, joined(0, np.nan), joined(1, False), joined(2, -np.inf), joined(3, False))


def crossings(
    mesh: TerrainMesh, x: F64, y: F64, above: float, rays: Rays | None = None
) -> tuple[NDArray[np.int64], F64, NDArray[np.bool_], NDArray[np.bool_]]:
    """All crossings of downward rays, by ray and then from above: (ray, z, faces up, was measured).

    Args:
        x, y: (M,) metres, one ray each.
        above: z to start at, metres.
        rays: the mesh's caster, if it is made already.
    """
    faces_up = across(mesh.vertices, mesh.triangles)[:, 2] > 0
    start = np.column_stack([x, y, np.full(len(x), above)])
    rays = rays or Rays(mesh.vertices, mesh.triangles)
    ray, t, triangle = rays.crossings(start, np.broadcast_to([0.0, 0.0, -1.0], start.shape))
    order = np.lexsort((t, ray))
    ray, z, triangle = ray[order], above - t[order], triangle[order]
    up, seen = faces_up[triangle], ~mesh.invented[triangle]
    # A ray through an edge that two triangles share is reported twice.
    again = np.zeros(len(ray), bool)
    again[1:] = (np.diff(ray) == 0) & (np.abs(np.diff(z)) < 1e-5) & (up[1:] == up[:-1])
    return ray[~again], z[~again], up[~again], seen[~again]


Intervals = tuple[F32, F32, NDArray[np.int32], NDArray[np.int32]]
"""Tops, bottoms, crossing that is the top, crossing that is the bottom (-1: none), each (L, count)."""


def _intervals(ray: NDArray[np.int64], z: F64, up: NDArray[np.bool_], count: int) -> Intervals:
    """Walk down all columns at once, crossing by crossing. Layers are added as they are needed: most of a room has one
    or two, and MAX_LAYERS of a fine grid would take gigabytes. Single precision is a micrometre here."""
    top, bottom = np.full((1, count), np.nan, np.float32), np.full((1, count), -np.inf, np.float32)
    above, below = np.full((1, count), -1, np.int32), np.full((1, count), -1, np.int32)
    depth, layer = np.zeros(count, np.int16), np.full(count, -1, np.int8)
    first = np.r_[True, np.diff(ray) != 0]
    start = np.flatnonzero(first)
    rank = np.arange(len(ray)) - np.repeat(start, np.diff(np.r_[start, len(ray)])) if len(ray) else np.zeros(0, int)
    for k in range(int(rank.max(initial=-1)) + 1):
        now = np.flatnonzero(rank == k)
        r, height, enters = ray[now], z[now], up[now]
        outside, room = depth[r] == 0, layer[r] < MAX_LAYERS - 1
        opens, sheet = enters & outside & room, ~enters & outside & room
        begins = opens | sheet
        layer[r[begins]] += 1
        if int(layer[r].max(initial=0)) == len(top):
            top, bottom = (
                np.vstack([a, np.full((1, count), v, np.float32)]) for a, v in ((top, np.nan), (bottom, -np.inf))
            )
            above, below = (np.vstack([a, np.full((1, count), -1, np.int32)]) for a in (above, below))
        top[layer[r[begins]], r[begins]] = np.where(sheet, height + SHEET, height)[begins]
        above[layer[r[begins]], r[begins]] = now[begins]
        closes = sheet | (~enters & (depth[r] == 1))
        bottom[layer[r[closes]], r[closes]] = height[closes]
        below[layer[r[closes]], r[closes]] = now[closes]
        depth[r] = np.maximum(depth[r] + np.where(enters, 1, -1), 0)
    return top, bottom, above, below


def _tidy(top: F32, bottom: F32, above: NDArray[np.int32], below: NDArray[np.int32], ground_z: float) -> Intervals:
    """Close gaps that are too narrow for anything, downwards from the topmost interval. In place."""
    for k in range(len(top) - 1, 0, -1):
        narrow = np.isfinite(top[k]) & (bottom[k - 1] - top[k] < NARROW)
        bottom[k - 1][narrow] = bottom[k][narrow]
        below[k - 1][narrow] = below[k][narrow]
        # What lay below moves up by one.
        for j in range(k, len(top)):
            last = j + 1 == len(top)
            for values, nothing in ((top, np.nan), (bottom, -np.inf), (above, -1), (below, -1)):
                values[j] = np.where(narrow, nothing if last else values[j + 1], values[j])
    grounded = np.isfinite(top) & (bottom < ground_z + NARROW)
    bottom[grounded] = -np.inf
    below[grounded] = -1
    return top, bottom, above, below


def check_extent(mesh: TerrainMesh) -> None:
    """Refuse a mesh without triangles, or of a size that no terrain has."""
    if len(mesh.triangles) == 0:
        raise ExportError("the mesh has no triangles")
    extent = float(np.ptp(used(mesh.vertices, mesh.triangles), 0).max())
    if not 0.02 <= extent <= 200:
        raise ExportError(
            "the mesh is not of a terrain's size",
            expected="0.02 to 200 metres",
            found=f"{extent:.4g} metres",
            hint="give the mesh's unit with --unit mm (or cm, inch)",
        )
