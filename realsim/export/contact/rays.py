"""Rays against a mesh whose pieces may touch: faces that lie in each other count as two."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import compact, connected, faces_by_place

F64 = NDArray[np.float64]
MOST = 256  # pieces kept apart; of a scan's thousands of specks, the smaller ones share


class Rays:
    """Open3D's ray caster with every connected piece of a mesh for itself.

    Of two faces of one geometry that a ray crosses at the same distance, Open3D lists one only, as it does where an
    edge is shared. Where a table's leg ends at the underside of its top, one of two faces that both count would be
    lost, and the leg with it.
    """

    def __init__(self, vertices: F64, triangles: NDArray[np.int32]) -> None:
        import open3d

        self._o3d: Any = open3d
        self.centre = (vertices.min(0) + vertices.max(0)) / 2
        """(3,) metres; Open3D computes in float32, near its origin."""
        self.scene: Any = open3d.t.geometry.RaycastingScene()
        piece = pieces(vertices, triangles)
        order = np.argsort(piece, kind="stable")
        self._order = order
        self._first = np.searchsorted(piece[order], np.arange(int(piece.max(initial=0)) + 1))
        for begin, end in zip(self._first, [*self._first[1:], len(order)], strict=True):
            points, faces = compact(vertices, triangles[order[begin:end]])
            self.scene.add_triangles(
                self.tensor(points - self.centre), self._o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32))
            )

    def tensor(self, values: F64) -> Any:
        """The same numbers for Open3D."""
        return self._o3d.core.Tensor(np.ascontiguousarray(values, np.float32))

    def cast(self, origins: F64, ways: F64) -> tuple[F64, NDArray[np.int64]]:
        """First hits of rays (N, 3), (N, 3): ((N,) metres, inf for none; (N,) triangle, -1 for none)."""
        hit = self.scene.cast_rays(self.tensor(np.concatenate([origins - self.centre, ways], 1)))
        t = hit["t_hit"].numpy().astype(np.float64)
        return t, np.where(np.isfinite(t), self._triangle(hit, np.isfinite(t)), -1)

    def all_hits(self, origins: F64, ways: F64) -> tuple[NDArray[np.int64], F64, NDArray[np.int64]]:
        """All hits, in no order: (ray, metres, triangle), each (M,)."""
        if not len(origins):  # Open3D crashes on no rays at all
            return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64)
        hits = self.scene.list_intersections(self.tensor(np.concatenate([origins - self.centre, ways], 1)))
        ray, t = hits["ray_ids"].numpy().astype(np.int64), hits["t_hit"].numpy().astype(np.float64)
        return ray, t, self._triangle(hits, np.ones(len(ray), bool))

    def _triangle(self, hits: Any, valid: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Index of the triangle in the mesh as it was given."""
        of = np.where(valid, hits["geometry_ids"].numpy().astype(np.int64), 0)
        within = np.where(valid, hits["primitive_ids"].numpy().astype(np.int64), 0)
        return np.asarray(self._order[self._first[of] + within])


def pieces(vertices: F64, triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(K,) number of the connected piece that each triangle belongs to, the largest first, at most MOST of them."""
    if not len(triangles):
        return np.zeros(0, np.int64)
    label = connected(faces_by_place(vertices, triangles))
    _, label, counts = np.unique(label, return_inverse=True, return_counts=True)
    rank = np.empty(len(counts), np.int64)
    rank[np.argsort(-counts, kind="stable")] = np.arange(len(counts))
    return np.minimum(rank[label.reshape(-1)], MOST - 1)
