"""Small operations on triangle meshes that several packages share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LOOSE = 0.05
"""Share of vertices without a triangle from which a warning is due. Sound meshes have next to none; a text file lists
all of its vertices before the triangles, so that one that lost its last tenth has more."""


def compact(
    vertices: ArrayLike, triangles: ArrayLike, *per_vertex: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.int32], *tuple[Any, ...]]:
    """Only the vertices that triangles use: (vertices, triangles, *per_vertex) with new indices, order kept."""
    F = np.asarray(triangles)
    used, inverse = np.unique(F, return_inverse=True)
    arrays = tuple(None if a is None else np.asarray(a)[used] for a in per_vertex)
    return (np.asarray(vertices)[used], inverse.reshape(F.shape).astype(np.int32), *arrays)


def loose_vertices(path: Path, count: int, triangles: NDArray[Any]) -> str | None:
    """A sentence where many vertices belong to no triangle, as in a file that ends early; None where few do.

    Args:
        path: the file; an .obj is counted again, because its reader leaves out what no triangle uses.
        count: vertices that were read. triangles: (K, 3).
    """
    if path.suffix.lower() == ".obj":
        with path.open("rb") as file:
            count = max(count, sum(line.startswith((b"v ", b"v\t")) for line in file))
    unused = 1 - len(np.unique(triangles)) / max(count, 1)
    if unused <= LOOSE:
        return None
    return f"{unused:.0%} of the vertices belong to no triangle: is the file cut off?"


def lonely_vertex(points: NDArray[Any]) -> str | None:
    """A sentence where one vertex of (V, 3), of a mesh or a cloud, makes it more than twice as long as without it."""
    if len(points) < 8:
        return None
    low, high = (np.sort(np.partition(points, ends, axis=0)[ends], axis=0) for ends in ([0, 1], [-2, -1]))
    first, last = points.argmin(axis=0), points.argmax(axis=0)
    size = float((high[1] - low[0]).max())
    for k in {*first.tolist(), *last.tolist()}:
        without = np.where(last == k, high[0], high[1]) - np.where(first == k, low[1], low[0])
        if size > 2 * float(without.max()):
            place = ", ".join(f"{v:.4g}" for v in points[k])
            return f"a single vertex at {place} makes it {size / float(without.max()):.1f} times as long: damaged?"
    return None


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
    import fast_simplification
    from scipy.spatial import cKDTree

    # Open3D's decimation takes minutes where many triangles lie in one plane (a floor); this one does not.
    points, faces = fast_simplification.simplify(V.astype(np.float32), F, target_count=limit)
    points = np.asarray(points, float)
    rgb = None if colors is None else np.asarray(colors, np.uint8)[cKDTree(V).query(points, workers=-1)[1]]
    return points, np.asarray(faces, np.int32), rgb
