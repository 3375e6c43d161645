"""Level faces of a cloud: planes, smooth and connected regions, and whether one is large enough to stand on."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import linked, near_pieces
from realsim.core.types import F64

LEAST_SIDE, LEAST_AREA = 0.30, 0.15
"""Metres and m²: two feet and some room. What is smaller is an obstacle, however level."""
LEVEL_DEG = 5.0
"""A platform's top is level to within this."""
STEP = 0.012
"""Metres: neighbouring cells of one face differ by less in height; two boxes that touch mostly differ by more."""


def plane_of(points: F64) -> tuple[F64, float]:
    """Slope (2,) and height at the origin of z = slope·xy + height, least squares with outliers dropped twice."""
    keep = np.ones(len(points), bool)
    for _ in range(3):
        A = np.column_stack([points[:, :2], np.ones(len(points))])
        solution = np.linalg.lstsq(A[keep], points[keep, 2], rcond=None)[0]
        residual = np.abs(points[:, 2] - A @ solution)
        keep = residual < max(3 * 1.4826 * float(np.median(residual)), 0.002)
    return solution[:2], float(solution[2])


def smooth_regions(points: F64, cell: float, least: float) -> list[NDArray[np.intp]]:
    """Groups of points whose cells are neighbours and differ by less than `STEP` in height, larger than `least` m²."""
    if not len(points):
        return []
    cells, shape = cells_of(points[:, :2], cell)
    flat = cells[:, 0] * shape[1] + cells[:, 1]
    used, index = np.unique(flat, return_inverse=True)
    height = np.bincount(index, points[:, 2]) / np.bincount(index)
    lookup = np.full((shape[0] + 2) * (shape[1] + 2), -1)
    row, column = np.divmod(used, shape[1])
    place = (row + 1) * (shape[1] + 2) + column + 1
    lookup[place] = np.arange(len(used))
    pairs = []
    for step in (1, shape[1] + 2, shape[1] + 3, shape[1] + 1):
        other = lookup[place + step]
        here = np.flatnonzero(other >= 0)
        here = here[np.abs(height[here] - height[other[here]]) < STEP]
        pairs.append(np.column_stack([here, other[here]]))
    edges = np.concatenate(pairs)
    component = linked(edges[:, 0], edges[:, 1], len(used))
    sizes = np.bincount(component)
    member = component[index]
    return [np.flatnonzero(member == k) for k in np.flatnonzero(sizes * cell**2 > least)]


def connected(points: F64, join: float, steep: float = 4.0, least: int = 50) -> list[NDArray[np.intp]]:
    """Groups of more than `least` points within `join` metres of their neighbours in the plan, a part of that in z.

    With a quarter, a step of 1.2 cm separates two faces that touch.
    """
    if not len(points):
        return []
    component = near_pieces(points * [1.0, 1.0, steep], join)
    return [np.flatnonzero(component == k) for k in np.flatnonzero(np.bincount(component) > least)]


def large(xy: F64, cell: float) -> bool:
    """Whether points (M, 2), `cell` metres apart, of a level face leave room to stand: a least side and area."""
    import cv2

    if len(xy) < 20:
        return False
    _, sides, _ = cv2.minAreaRect(xy.astype(np.float32))
    return min(sides) > LEAST_SIDE and seen_area(xy, cell) > LEAST_AREA


def seen_area(xy: F64, cell: float) -> float:
    """m^2 of the cells with points in them."""
    return len(np.unique(np.floor(xy / cell).astype(np.int64) @ [1_000_003, 1])) * cell**2


def cells_of(xy: F64, cell: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Cell of each point on a grid that just holds them all, and the grid's shape."""
    cells = np.floor((xy - xy.min(0)) / cell).astype(np.int64)
    return cells, (int(cells[:, 0].max()) + 1, int(cells[:, 1].max()) + 1)
