"""`hybrid`: boxes and prisms where the surface is planar, convex decomposition for the rest."""

import numpy as np

from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel
from realsim.export.contact.convex import check_columns, with_parts
from realsim.export.contact.islands import Island, Terrain
from realsim.export.contact.prisms import as_contact
from realsim.export.contact.seams import overlap
from realsim.export.contact.shape import Shape

MANY = 40  # prisms: a surface that takes more is not made of planes


def hybrid(shape: Shape, config: SceneConfig) -> ContactModel:
    """Island by island whichever describes it: planes, or convex parts of its solid.

    Raises:
        UnsuitedError: too much of the terrain is curved.
    """
    fine = shape.fine
    flat = [p.misfit <= fine.tolerance and len(p.prisms) <= MANY for p in shape.planar]
    prisms = [prism for p, good in zip(shape.planar, flat, strict=True) if good for prism in p.prisms]
    curved = [island for island, good in zip(fine.islands, flat, strict=True) if not good]
    # Counted before the coarse solids are made, which takes its time too.
    check_columns(fine, curved, config)
    coarse = shape.coarse
    chosen = sorted({n for island in curved for n in _same_place(fine, island, coarse)})
    contact = as_contact("hybrid", prisms, fine.floor, fine.statistics | {"convex_islands": len(chosen)}, shape.solids)
    return overlap(with_parts(contact, shape, chosen, config), fine.tolerance, fine.adds)


def _same_place(fine: Terrain, island: Island, coarse: Terrain) -> set[int]:
    """Indices of the coarse islands that hold cells of a fine one, at about the same height."""
    rows, columns = np.nonzero(np.isfinite(island.top))
    xy = fine.grid.xy(rows + island.corner[0], columns + island.corner[1])
    column, row = np.rint((xy - coarse.grid.lower) / coarse.grid.cell).astype(int).T
    z = island.top[rows, columns]
    found = set()
    for n, other in enumerate(coarse.islands):
        r, c = row - other.corner[0], column - other.corner[1]
        inside = (r >= 0) & (c >= 0) & (r < other.top.shape[0]) & (c < other.top.shape[1])
        # Neighbouring islands share a rim cell now and then: most of the cells have to agree.
        if (np.abs(other.top[r[inside], c[inside]] - z[inside]) < 0.02).sum() > 0.5 * len(z):
            found.add(n)
    return found
