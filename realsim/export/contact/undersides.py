"""Lower end of the solid under a top: the ground, or an underside, estimated where no camera saw it."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across
from realsim.core.types import F64, TerrainMesh
from realsim.export.contact.columns import NARROW, Columns

STEEP = 0.5  # most |z| of a side face's normal
BIN = 4  # cells: side faces are looked at in pieces of the rim
ENOUGH = 5  # pieces of the rim that have to agree on where the side faces end
AGREE = 0.015  # metres of robust spread up to which they do


class Walls:
    """The measured side faces of a mesh, to look up how far down they reach."""

    def __init__(self, mesh: TerrainMesh) -> None:
        corners = mesh.vertices[mesh.seen]
        normal = across(mesh.vertices, mesh.seen)
        length = np.linalg.norm(normal, axis=1)
        steep = np.abs(normal[:, 2]) < STEEP * np.maximum(length, 1e-20)
        corners = corners[steep]
        self.xy = corners.mean(1)[:, :2]
        """(M, 2) their middles."""
        self.low, self.high = corners[:, :, 2].min(1), corners[:, :, 2].max(1)
        """(M,) where they begin and end."""

    def end_below(self, chosen: NDArray[np.int64], top: float) -> float:
        """z at which the side faces `chosen`, followed down from `top` without a break, end."""
        end = top
        for k in chosen[np.argsort(-self.high[chosen], kind="stable")]:
            if self.high[k] < end - NARROW:
                break
            end = min(end, float(self.low[k]))
        return end


def settle(
    grid: Columns,
    corner: tuple[int, int],
    top: F64,
    under: F64,
    unseen: NDArray[np.bool_],
    base: float,
    narrowest: int,
    walls: Walls,
) -> tuple[F64, F64]:
    """The underside of an island, without the artefacts of its mesh.

    A scanned wall is never quite upright, so that columns at an edge may miss the underside (a curtain down to the
    ground) or find one where there is none (a wall that hangs over): strips narrower than `narrowest` cells go with
    what is beside them. An underside that no camera saw, above a gap that the mesh leaves free, follows the top at the
    distance at which the measured side faces end; where these do not agree, it stays where the mesh has it.

    Args:
        corner: row and column of the island in the grid.
        top, under: (rows, columns) z, NaN outside; `under` is `base` where the island stands on the ground.
        unseen: (rows, columns) cells whose underside was not measured.

    Returns:
        (`under` anew, (2,) m^2 of unseen undersides that follow the side faces, and of those that do not).
    """
    from scipy import ndimage

    inside = np.isfinite(top)
    hanging = inside & (under > base)
    block = np.ones((narrowest, narrowest))
    hangs = ndimage.binary_opening(hanging, block)
    stands = ndimage.binary_opening(inside & ~hanging, block)
    if not (hangs | stands).any() and 2 * hanging.sum() > inside.sum():  # a bit that floats, all of it too narrow
        hangs = hanging
    out = np.where(inside, base, np.nan)
    areas = np.zeros(2)
    if not hangs.any():
        return out, areas
    near = ndimage.distance_transform_cdt(~(hangs | stands), "taxicab", return_distances=False, return_indices=True)
    raised = inside & hangs[near[0], near[1]]
    out[raised] = under[near[0], near[1]][raised]
    pieces, count = ndimage.label(raised, np.ones((3, 3)))
    for k in range(1, count + 1):
        piece = pieces == k
        if (unseen & hangs)[piece].sum() <= 0.5 * hangs[piece].sum():
            continue
        thickness = _thickness(grid, corner, top, piece, base, walls)
        if thickness is not None:
            out[piece] = np.maximum(out[piece], top[piece] - thickness)
        areas[int(thickness is None)] += piece.sum() * grid.cell**2
    return out, areas


def _thickness(
    grid: Columns, corner: tuple[int, int], top: F64, piece: NDArray[np.bool_], base: float, walls: Walls
) -> float | None:
    """Metres from a top down to where its measured side faces end above a gap; None where they do not tell."""
    from scipy import ndimage

    rim = np.argwhere(piece & ~ndimage.binary_erosion(piece, np.ones((3, 3))))
    low, high = grid.xy(*(rim.min(0) + corner)), grid.xy(*(rim.max(0) + corner))
    margin = 2 * grid.cell
    around = np.flatnonzero(((walls.xy > low - margin) & (walls.xy < high + margin)).all(1))
    level = float(np.nanmedian(top[piece]))
    found = []
    _, bins = np.unique(rim // BIN, axis=0, return_inverse=True)
    for k in range(int(bins.max()) + 1):
        cells = rim[bins.reshape(-1) == k]
        middle = grid.xy(*(cells.mean(0) + corner))
        here = around[np.abs(walls.xy[around] - middle).max(1) < (BIN / 2 + 2) * grid.cell]
        highest = max(level, float(np.nanmax(top[cells[:, 0], cells[:, 1]])))
        end = walls.end_below(here, highest)
        if end < highest - NARROW and end > base + NARROW:
            found.append(highest - end)
    if len(found) < ENOUGH:
        return None
    thickness = float(np.median(found))
    spread = 1.4826 * float(np.median(np.abs(np.array(found) - thickness)))
    return thickness if spread < AGREE else None
