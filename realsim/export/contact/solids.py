"""Closed solids of what stands on the ground, from columns: for representations that need an inside."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64
from realsim.export.contact.islands import Island, Terrain

DEPTH = 0.02  # metres that solids reach into the ground


def island_solid(whole: Terrain, island: Island) -> tuple[F64, NDArray[np.int32]]:
    """((V, 3) metres, (K, 3)) closed surface of an island: marching cubes over the distance to its top and underside.

    The field is linear in z, so that level and sloping faces come out where they are; vertical faces come out between
    the cells, and undersides that reach the ground end DEPTH below it.
    """
    from skimage.measure import marching_cubes

    cell = whole.grid.cell
    top = np.pad(island.top, 2, constant_values=np.nan)
    under = np.pad(island.under, 2, constant_values=np.nan)
    under = np.where(under <= whole.base, whole.base - DEPTH, under)
    # Off the faces by an odd part of a cell: nodes exactly on a face make triangles without area.
    lowest, highest = np.nanmin(under) - 2.37 * cell, np.nanmax(top) + 2 * cell
    z = np.arange(lowest, highest + cell, cell)
    field = np.minimum(top[..., None] - z, z - under[..., None])
    # Beside the island the field is as far outside as half a cell: walls come out half way between cells.
    field = np.clip(np.where(np.isfinite(field), field, -cell / 2), -cell / 2, cell / 2)
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    xy = whole.grid.xy(vertices[:, 0] - 2 + island.corner[0], vertices[:, 1] - 2 + island.corner[1])
    points = np.column_stack([xy, lowest + cell * vertices[:, 2]])
    return points, np.ascontiguousarray(faces, np.int32)
