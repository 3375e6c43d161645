"""Closed convex pieces of a mesh, and triangles that it has twice."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import connected, edges_of, faces_by_place, groups, linked
from realsim.core.types import F64

I32 = NDArray[np.int32]
DENT = 0.0005
"""Metres that a piece may be hollow and still be taken for convex: a fiftieth of what is felt."""
ROUND = 0.003
"""Metres, in the mean, by which the hull of fewer corners may lie inside a rounded piece."""
MOST_CORNERS = 200
"""Of one convex part; what has more is rounded, and fitted by other means if its hull cannot be had with so few."""
THIN = 0.002
"""Metres: a thinner piece stops nothing, and MuJoCo finds no hull of a plane."""


def without_twins(vertices: F64, triangles: I32) -> tuple[I32, int]:
    """(triangles (K, 3) without those that are there again, how many those were).

    Two of the same corners that face the same way are one. Two that face apart are both kept where two solids touch;
    where a surface is written once for each of its sides (most of a connected piece is), one of them is enough.

    Args:
        vertices: (V, 3) metres; those at the same place count as one. triangles: (K, 3).
    """
    faces = faces_by_place(vertices, triangles)
    corners = np.sort(faces, axis=1)
    corners = corners[np.lexsort(corners.T)]
    if not (corners[1:] == corners[:-1]).all(1).any():
        return triangles, 0
    first = faces.argmin(1)
    turned = faces[np.arange(len(faces))[:, None], (first[:, None] + np.arange(3)) % 3]
    _, kept = np.unique(turned, axis=0, return_index=True)
    kept = np.sort(kept)
    corners = np.sort(faces[kept], axis=1)
    _, group, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    paired = counts[group] > 1
    if paired.any():
        piece = connected(faces[kept])
        double_sided = np.bincount(piece, paired) > 0.5 * np.bincount(piece)
        lose = np.ones(len(kept), bool)
        lose[np.unique(group, return_index=True)[1]] = False
        kept = kept[~(lose & double_sided[piece])]
    return np.ascontiguousarray(triangles[kept]), len(triangles) - len(kept)


def convex_solids(vertices: F64, triangles: I32) -> tuple[tuple[F64, ...], NDArray[np.bool_]]:
    """([(M, 3) corners] of closed pieces that are convex, (K,) the triangles that belong to none of them).

    People build scenes of boxes, cylinders and boards: as they stand, such parts need no fitting.

    Args:
        vertices: (V, 3) metres; those at the same place count as one. triangles: (K, 3), facing out.
    """
    faces = faces_by_place(vertices, triangles)
    edges = edges_of(faces)
    # Across edges of just two triangles, so that solids which touch in an edge are two.
    once = edges.first[edges.uses == 2]
    piece = linked(edges.order[once] // 3, edges.order[once + 1] // 3, len(triangles))
    rim = np.zeros(len(triangles), bool)
    rim[piece[edges.order[edges.first[edges.uses % 2 > 0]] // 3]] = True
    others = np.ones(len(triangles), bool)
    solids = []
    for members in groups(piece):
        corners = None if rim[piece[members[0]]] else _convex(vertices[triangles[members]], faces[members])
        if corners is not None:
            others[members] = False
            solids.append(corners)
    return tuple(solids), others


def _convex(corners: F64, faces: I32) -> F64 | None:
    """Corners (M, 3) of the hull of triangles (N, 3, 3), where they are closed and its surface; else None."""
    from scipy.spatial import ConvexHull, QhullError

    runs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    runs = runs[np.lexsort(runs.T)]
    back = runs[np.lexsort((runs[:, 1], runs[:, 0]))][:, ::-1]
    if len(faces) < 4 or not np.array_equal(runs, back):
        return None
    points = np.unique(corners.reshape(-1, 3), axis=0)
    middle = points.mean(0)
    if np.linalg.svd(points - middle, compute_uv=False, full_matrices=False)[-1] < 1e-6:
        return None
    try:
        hull = ConvexHull(points - middle)
    except QhullError:
        return None
    local = corners - middle
    volume = float(np.einsum("ij,ij->", local[:, 0], np.cross(local[:, 1], local[:, 2]))) / 6
    if hull.volume - volume > DENT * hull.area / 2 or volume <= 0:
        return None
    outer = points[hull.vertices] - middle
    if len(hull.vertices) > MOST_CORNERS:
        outer = _fewer(outer)
        if ConvexHull(outer).volume < hull.volume - ROUND * hull.area:
            return None
    planes = np.unique(np.round(hull.equations, 9), axis=0)
    for some in np.array_split(points - middle, max(1, len(points) * len(planes) // 5_000_000)):
        if (some @ planes[:, :3].T + planes[:, 3]).max(1).min() < -DENT:
            return None
    span = -(outer @ planes[:, :3].T + planes[:, 3]).min(0)
    return outer + middle if span.min() >= THIN else None


def _fewer(points: F64) -> F64:
    """Those of the corners of a convex body (M, 3) that are the farthest in one of MOST_CORNERS directions."""
    k = np.arange(MOST_CORNERS) + 0.5
    z, turn = 1 - 2 * k / MOST_CORNERS, np.pi * (1 + 5**0.5) * k
    ways = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    return points[np.unique((points @ ways.T).argmax(0))]
