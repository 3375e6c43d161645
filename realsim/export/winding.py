"""Triangles that face the wrong way among their neighbours, turned round."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def turn_stray(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """Triangles that all face the way most of their connected piece does.

    Two triangles that share an edge face the same way if they run along it in opposite directions. In a graph with two
    nodes a triangle, as it is and turned, every shared edge joins the nodes that suit each other; a piece of a mesh
    that has two sides then falls into two, of which the one that turns fewer triangles is taken. Pieces without two
    sides (a Moebius strip) and edges of more than two triangles are left alone.

    Args:
        vertices: (V, 3); those at the same place count as one. triangles: (K, 3).

    Returns:
        ((K, 3) triangles, how many were turned).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(triangles)
    runs, order, first, uses = _edges(_merged(vertices, triangles))
    pairs = first[uses == 2]
    a, b = order[pairs], order[pairs + 1]
    against = runs[a, 0] == runs[b, 0]  # both run along the edge in the same direction
    if not against.any():
        return triangles, 0
    one, other = a // 3, b // 3 + count * against
    across = np.where(other < count, other + count, other - count)
    rows, columns = np.r_[one, one + count], np.r_[other, across]
    graph = coo_matrix((np.ones(len(rows), bool), (rows, columns)), (2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    kept, turned = label[:count], label[count:]
    # How many triangles stay as they are where a component is chosen.
    stay = np.bincount(kept, minlength=int(label.max()) + 1)
    turn = (stay[turned] > stay[kept]) | ((stay[turned] == stay[kept]) & (turned < kept))
    out = np.where(turn[:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(out, np.int32), int(turn.sum())


def turn_closed(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """Triangles of closed pieces facing out, where they all faced in: (triangles (K, 3), how many pieces were turned).

    A hollow in a solid is turned as well, and is then full: nothing outside can touch it.

    Args:
        vertices: (V, 3) metres; those at the same place count as one. triangles: (K, 3).
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = _merged(vertices, triangles)
    runs, order, first, uses = _edges(faces)
    size = int(faces.max()) + 1
    graph = coo_matrix((np.ones(len(runs), bool), (runs[:, 0], runs[:, 1])), (size, size))
    count, label = connected_components(graph, directed=False)
    piece = label[faces[:, 0]]
    closed = np.ones(count, bool)
    closed[piece[order[first[uses != 2]] // 3]] = False
    corners = vertices[triangles] - vertices.mean(0)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    inward = closed & (np.bincount(piece, volume, count) < -1e-9)
    out = np.where(inward[piece][:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(out, np.int32), int(inward.sum())


def _merged(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(K, 3) triangles over vertices of which there is one a place (0.1 micrometres)."""
    _, merged = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    return np.asarray(merged.reshape(-1)[triangles], np.int64)


def _edges(
    faces: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(from and to of every side (3K, 2), sides in order of their edge, first side of each edge in that order, how many
    sides each edge has)."""
    runs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key = runs.min(1) * (int(faces.max()) + 1) + runs.max(1)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(key[order]) != 0])
    return runs, order, first, np.diff(np.r_[first, len(order)])
