"""Small operations on triangle meshes that several packages share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def compact(
    vertices: ArrayLike, triangles: ArrayLike, *per_vertex: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.int32], *tuple[Any, ...]]:
    """Only the vertices that triangles use: (vertices, triangles, *per_vertex) with new indices, order kept."""
    F = np.asarray(triangles)
    used, inverse = np.unique(F, return_inverse=True)
    arrays = tuple(None if a is None else np.asarray(a)[used] for a in per_vertex)
    return (np.asarray(vertices)[used], inverse.reshape(F.shape).astype(np.int32), *arrays)


def simplify(
    vertices: ArrayLike, triangles: ArrayLike, colors: ArrayLike | None, limit: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8] | None]:
    """A mesh of at most about `limit` triangles to look at (quadric decimation; Garland and Heckbert 1997).

    Its error has no bound: never for collisions or for what is measured.

    Args:
        vertices: (V, 3); triangles: (K, 3); colors: (V, 3) uint8 or None.
    """
    V, F = np.asarray(vertices, float), np.asarray(triangles, np.int32)
    if len(F) <= limit:
        return V, F, None if colors is None else np.asarray(colors, np.uint8)
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(V), o3d.utility.Vector3iVector(F))
    if colors is not None:
        mesh.vertex_colors = o3d.utility.Vector3dVector(np.asarray(colors, float) / 255)
    mesh = mesh.simplify_quadric_decimation(limit)
    rgb = np.asarray(mesh.vertex_colors)
    return (
        np.asarray(mesh.vertices),
        np.asarray(mesh.triangles).astype(np.int32),
        (rgb * 255).round().clip(0, 255).astype(np.uint8) if len(rgb) else None,
    )
