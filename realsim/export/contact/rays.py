"""Rays against a mesh whose pieces may touch: faces that lie in each other count as two."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core import rays
from realsim.core.meshes import compact, connected, faces_by_place
from realsim.core.types import F64

MOST = 256  # pieces kept apart; of a scan's thousands of specks, the smaller ones share


class Rays(rays.Rays):
    """A mesh under rays with every connected piece for itself.

    Of two faces of one geometry that a ray crosses at the same distance, Open3D lists one only, as it does where an
    edge is shared. Where a table's leg ends at the underside of its top, one of two faces that both count would be
    lost, and the leg with it.
    """

    def __init__(self, vertices: F64, triangles: NDArray[np.int32]) -> None:
        piece = pieces(vertices, triangles)
        self._order = np.argsort(piece, kind="stable")
        self._first = np.searchsorted(piece[self._order], np.arange(int(piece.max(initial=0)) + 1))
        first, *others = (triangles[part] for part in np.split(self._order, self._first[1:]))
        super().__init__(vertices, first)
        for faces in others:
            points, corners = compact(vertices - self.centre, faces)
            rays.add(self._scene, points, corners)

    def _triangles(self, hits: Any) -> NDArray[np.int64]:
        """Index in the mesh as it was given, -1 for none."""
        within = super()._triangles(hits)
        of = np.where(within < 0, 0, hits["geometry_ids"].numpy().astype(np.int64))
        return np.where(within < 0, -1, self._order[self._first[of] + within])


def pieces(vertices: F64, triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(K,) number of the connected piece that each triangle belongs to, the largest first, at most MOST of them."""
    if not len(triangles):
        return np.zeros(0, np.int64)
    label = connected(faces_by_place(vertices, triangles))
    _, label, counts = np.unique(label, return_inverse=True, return_counts=True)
    rank = np.empty(len(counts), np.int64)
    rank[np.argsort(-counts, kind="stable")] = np.arange(len(counts))
    return np.minimum(rank[label.reshape(-1)], MOST - 1)
