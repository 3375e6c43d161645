"""A height image in pieces that are planar."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
WINDOW = 5  # cells a side over which a cell's own plane is fitted
SMALLEST = 12  # cells: what is smaller is not worth a plane


def segment(z: F64, cell: float, tolerance: float) -> tuple[I64, F64]:
    """Grow planes over a height image until none fits what is left.

    The widest smooth place not yet taken is the next seed; its plane takes what is connected to it and lies within
    `tolerance`, and is fitted again to what it took.

    Args:
        z: (rows, columns) metres, NaN where there is nothing.
        cell: metres between cells.
        tolerance: metres perpendicular to the plane.

    Returns:
        (rows, columns) index of the plane or -1, and (P, 3) planes a b c with z = a column + b row + c (in cells).
    """
    from scipy import ndimage

    rows, columns = np.indices(z.shape)
    labels = np.full(z.shape, -1)
    planes: list[F64] = []
    smooth = _roughness(z, cell) < tolerance / 2
    free = np.isfinite(z)
    while True:
        candidates = np.pad(smooth & free, 1)
        if candidates.sum() < SMALLEST:
            break
        depth = ndimage.distance_transform_cdt(candidates, "chessboard")[1:-1, 1:-1]
        seed = np.unravel_index(int(np.argmax(depth)), depth.shape)
        reach = max(int(depth[seed]) - 1, 1)
        near = free & (np.abs(rows - seed[0]) <= reach) & (np.abs(columns - seed[1]) <= reach)
        taken = near
        for _ in range(5):
            plane = _fit(z, taken)
            off = np.abs(z - (plane[0] * columns + plane[1] * rows + plane[2]))
            fits = free & (off * _steepness(plane, cell) < tolerance)
            pieces, _ = ndimage.label(fits)
            home = pieces[seed]
            grown = pieces == home if home else near
            if (grown == taken).all():
                break
            taken = grown
        if taken.sum() >= SMALLEST:
            labels[taken] = len(planes)
            planes.append(_fit(z, taken))
            free &= ~taken
        smooth &= ~taken  # whether it became a plane or not, it is no seed any more
        smooth[seed] = False
    return labels, np.array(planes).reshape(-1, 3)


def heights(plane: F64, shape: tuple[int, int]) -> F64:
    """(rows, columns) z of a plane a b c."""
    rows, columns = np.indices(shape)
    return plane[0] * columns + plane[1] * rows + plane[2]


def spread(labels: I64, inside: NDArray[np.bool_], cost: F64, outside: F64 | None = None) -> I64:
    """Give every cell inside that has no label that of the neighbour which suits it best.

    A blurred edge between two faces is thereby cut half way up, where the true edge is.

    Args:
        labels: (rows, columns), -1 where unlabelled.
        inside: (rows, columns) cells that want a label.
        cost: (P, rows, columns) misfit of each label at each cell.
        outside: (rows, columns) misfit of being no part of this at all, or None where that is no choice. Cells at the
            rim may choose it, and are -1 in the result.
    """
    labels = np.pad(labels, 1, constant_values=-1)
    gone = np.pad(~inside, 1, constant_values=True)
    index = np.indices(inside.shape)
    shifts = ((-1, 0), (1, 0), (0, -1), (0, 1))
    rows, columns = inside.shape
    while True:
        open_ = (labels == -1) & ~gone
        best = np.full(inside.shape, np.inf)
        choice = np.full(inside.shape, -2)
        for dr, dc in shifts:
            part = (slice(1 + dr, 1 + dr + rows), slice(1 + dc, 1 + dc + columns))
            neighbour = labels[part]
            known = neighbour >= 0
            if len(cost):
                value = np.where(known, cost[np.maximum(neighbour, 0), index[0], index[1]], np.inf)
                better = value < best
                best, choice = np.where(better, value, best), np.where(better, neighbour, choice)
            if outside is not None:
                better = gone[part] & (outside < best)
                best, choice = np.where(better, outside, best), np.where(better, -1, choice)
        centre = open_[1:-1, 1:-1]
        decided = centre & (choice != -2)
        if not decided.any():
            return labels[1:-1, 1:-1]
        labels[1:-1, 1:-1][decided] = choice[decided]
        gone[1:-1, 1:-1] |= decided & (choice == -1)


def _fit(z: F64, where: NDArray[np.bool_]) -> F64:
    """Least-squares a b c over the cells of a mask."""
    rows, columns = np.nonzero(where)
    r0, c0 = rows.mean(), columns.mean()
    A = np.stack([columns - c0, rows - r0, np.ones(len(rows))], 1)
    a, b, c = np.linalg.lstsq(A, z[where], rcond=None)[0]
    return np.array([a, b, c - a * c0 - b * r0])


def _steepness(plane: F64, cell: float) -> float:
    """z component of a plane's unit normal: turns vertical distances into perpendicular ones."""
    return float(1 / np.sqrt(1 + (plane[0] / cell) ** 2 + (plane[1] / cell) ** 2))


def _roughness(z: F64, cell: float) -> F64:
    """(rows, columns) RMS distance, metres, of a cell's window from its own plane; inf at rims and steps."""
    from scipy import ndimage

    known = np.isfinite(z)
    base = np.nanmean(z) if known.any() else 0.0
    full = np.where(known, z - base, 0.0)
    k = np.arange(WINDOW) - WINDOW // 2
    flat = np.ones(WINDOW)

    def moment(values: F64, along_row: F64, along_column: F64) -> F64:
        once = ndimage.correlate1d(values, along_column, axis=1, mode="constant")
        return ndimage.correlate1d(once, along_row, axis=0, mode="constant")

    n = WINDOW**2
    spread_ = WINDOW * float((k**2).sum())
    mean = moment(full, flat, flat) / n
    slope_c = moment(full, flat, k.astype(float)) / spread_
    slope_r = moment(full, k.astype(float), flat) / spread_
    square = moment(full**2, flat, flat) / n
    variance = square - mean**2 - (slope_c**2 + slope_r**2) * spread_ / n
    steep = np.sqrt(1 + (slope_c / cell) ** 2 + (slope_r / cell) ** 2)
    whole = moment(known.astype(float), flat, flat) > n - 0.5
    return np.where(whole, np.sqrt(np.maximum(variance, 0)) / steep, np.inf)
