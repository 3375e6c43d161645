"""Solids of a mesh that overlap, made one: what lies inside another solid is no surface that anything can touch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import connected, edges_of, faces_by_place, groups
from realsim.core.types import F64

I32 = NDArray[np.int32]

SHARED = 1e-6
"""Share of the solids' volume that two of them must share, lest rounding be taken for an overlap."""


def united(vertices: F64, triangles: I32) -> tuple[F64, I32, int]:
    """Vertices, triangles, and how many closed pieces were made one, 0 where none overlap; open pieces stay.

    Args:
        vertices: (V, 3) metres. triangles: (K, 3), closed pieces facing out.
    """
    from manifold3d import Manifold, OpType

    solids: list[Any] = []
    rest = np.arange(len(triangles))
    merged = faces_by_place(vertices, triangles)
    # By place, solids that share an edge are one piece, and still overlap; by their own vertices, an STL has no piece.
    for faces in (triangles, merged):
        open_ = [rest[:0]]
        for piece in groups(connected(faces[rest])):
            solid = _solid(vertices, triangles[rest[piece]])
            (open_.append(rest[piece]) if solid is None else solids.append(solid))
        rest = np.sort(np.concatenate(open_))
    whole = Manifold.batch_boolean(solids, OpType.Add) if solids else None
    if whole is None or whole.volume() > (1 - SHARED) * sum(solid.volume() for solid in solids):
        return vertices, triangles, 0
    union = whole.to_mesh64()
    joined = np.asarray(union.tri_verts).astype(np.int32) + len(vertices)
    corners = np.asarray(union.vert_properties, np.float64)[:, :3]
    return np.concatenate([vertices, corners]), np.concatenate([triangles[rest], joined]).astype(np.int32), len(solids)


def _solid(vertices: F64, triangles: I32) -> Any:
    """The solid of triangles (K, 3), or None where they do not close one."""
    from manifold3d import Manifold, Mesh64

    if len(triangles) < 4:
        return None
    places, faces = np.unique(np.round(vertices[triangles], 7).reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    edges = edges_of(faces)
    ways = np.sign(edges.runs[:, 1] - edges.runs[:, 0])
    # Of some that do not close, Manifold crashes.
    if not ways.all() or np.add.reduceat(ways[edges.order], edges.first).any():
        return None
    solid = Manifold(Mesh64(places, faces.astype(np.uint64)))
    return None if solid.is_empty() or solid.volume() <= 0 else solid
