"""Triangles that face the wrong way among their neighbours, turned round."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import connected, edges_of, faces_by_place, linked
from realsim.export.contact.probe import CEILING


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
    count = len(triangles)
    edges = edges_of(faces_by_place(vertices, triangles))
    pairs = edges.first[edges.uses == 2]
    a, b = edges.order[pairs], edges.order[pairs + 1]
    against = edges.runs[a, 0] == edges.runs[b, 0]  # both run along the edge in the same direction
    if not against.any():
        return triangles, 0
    one, other = a // 3, b // 3 + count * against
    across = np.where(other < count, other + count, other - count)
    label = linked(np.r_[one, one + count], np.r_[other, across], 2 * count)
    kept, turned = label[:count], label[count:]
    # How many triangles stay as they are where a component is chosen.
    stay = np.bincount(kept, minlength=int(label.max()) + 1)
    turn = (stay[turned] > stay[kept]) | ((stay[turned] == stay[kept]) & (turned < kept))
    out = np.where(turn[:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(out, np.int32), int(turn.sum())


def turn_closed(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """Triangles of closed pieces facing out, where they all faced in: (triangles (K, 3), how many pieces were turned).

    A hollow in a solid is turned as well, and is then full: nothing outside can touch it. A room that one can stand in,
    with another piece in it, is none.

    Args:
        vertices: (V, 3) metres; those at the same place count as one. triangles: (K, 3).
    """
    faces = faces_by_place(vertices, triangles)
    edges = edges_of(faces)
    piece = connected(faces)
    count = int(piece.max()) + 1
    closed = np.ones(count, bool)
    closed[piece[edges.order[edges.first[edges.uses != 2]] // 3]] = False
    if not closed.any():
        return triangles, 0
    corners = vertices[triangles] - vertices.mean(0)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    inward = closed & (np.bincount(piece, volume, count) < -1e-9)
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lower, piece, corners.min(1))
    np.maximum.at(upper, piece, corners.max(1))
    for k in np.flatnonzero(inward & ((upper - lower)[:, 2] > CEILING)):
        within = ((lower >= lower[k]) & (upper <= upper[k])).all(1)
        inward[k] = within.sum() == 1  # itself
    out = np.where(inward[piece][:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(out, np.int32), int(inward.sum())
