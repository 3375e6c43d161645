"""A height image in pieces that are planar."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64

I64 = NDArray[np.int64]
Window = tuple[slice, slice]
Misfit = Callable[..., F64]
WINDOWS = (5, 3)  # cells a side over which a cell's own plane is fitted; the small one for narrow faces
MOST_SEEDS = 250  # places tried for a plane: a surface that needs more is not made of planes, and each costs a pass
# Set by hand on four made terrains of 200,000 triangles (more than 262 s before, half a minute then). A scanned room is
# not made of planes by it either: sheets come last there, not first.
FIRST, HOLD = 20, 0.5  # places after which it is foreseen whether all MOST_SEEDS of them would hold this share of it
SMALLEST = 12  # cells: what is smaller is not worth a plane


def segment(z: F64, cell: float, tolerance: float, narrowest: int = 1) -> tuple[I64, F64] | None:
    """Grow planes over a height image until none fits what is left, or `MOST_SEEDS` places were tried.

    The widest smooth place not yet taken is the next seed; its plane takes what is connected to it and lies within
    `tolerance`, and is fitted again to what it took.

    Args:
        z: (rows, columns) metres, NaN where there is nothing.
        cell: metres between cells.
        tolerance: metres perpendicular to the plane.
        narrowest: cells; what is narrower is an edge rounded by the mesh, and no face of its own.

    Returns:
        (rows, columns) index of the plane or -1, and (P, 3) planes a b c with z = a column + b row + c (in cells); None
        of a surface that is not made of planes.
    """
    labels = np.full(z.shape, -1)
    planes: list[F64] = []
    free = np.isfinite(z)
    tried, took, wanted = 0, 0, HOLD * free.sum()
    for window in WINDOWS:
        smooth = free & (_roughness(np.where(free, z, np.nan), cell, window) < tolerance / 2)
        depth = _depth(smooth)
        while tried < MOST_SEEDS and (seed := _deepest(depth)) is not None:
            tried += 1
            part, taken = _grown(z, free, *seed, cell, tolerance)
            plane = _fit(z[part], taken)
            if taken.sum() >= SMALLEST and not _is_edge(taken, plane, cell, narrowest):
                labels[part][taken] = len(planes)
                a, b, c = plane
                planes.append(np.array([a, b, c - a * part[1].start - b * part[0].start]))
                free[part] &= ~taken
                took += int(taken.sum())
            if tried >= FIRST and took * MOST_SEEDS < wanted * tried:  # the widest places are tried first
                return None
            smooth[part] &= ~taken  # whether it became a plane or not, it is no seed any more
            smooth[seed[0]] = False
            _shallower(depth, smooth, part)
    return labels, np.array(planes).reshape(-1, 3)


def _is_edge(taken: NDArray[np.bool_], plane: F64, cell: float, narrowest: int) -> bool:
    """A tilted strip narrower than `narrowest` cells is a rounded edge; one steeper than 75 degrees and at most three
    cells wide is a scanned wall. Both are better cut upright than kept as planes."""
    seed = _deepest(_depth(taken))
    assert seed is not None
    width, steep = 2 * seed[1] - 1, _steepness(plane, cell)
    return (width < narrowest and steep < np.cos(np.radians(10))) or (width <= 3 and steep < np.cos(np.radians(75)))


def _depth(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(rows, columns) cells from each cell of a mask to its rim; 0 outside."""
    from scipy import ndimage

    return np.asarray(ndimage.distance_transform_cdt(np.pad(mask, 1), "chessboard")[1:-1, 1:-1], np.int32)


def _deepest(depth: NDArray[np.int32]) -> tuple[tuple[int, int], int] | None:
    """(the cell that is farthest from a mask's rim, how far in cells), None for an empty mask."""
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return ((int(row), int(column)), int(depth[row, column])) if depth[row, column] else None


def _shallower(depth: NDArray[np.int32], mask: NDArray[np.bool_], window: Window) -> None:
    """Depths of a mask anew, in place, of which cells in a window have gone: nothing changes farther off than the
    greatest depth, and nothing beyond twice that matters."""
    reach = int(depth.max())
    near, around = (
        [(max(w.start - k * reach, 0), min(w.stop + k * reach, n)) for w, n in zip(window, depth.shape, strict=True)]
        for k in (1, 2)
    )
    (r0, r1), (c0, c1) = near
    (top, _), (left, _) = around
    anew = _depth(mask[tuple(slice(*ends) for ends in around)])
    depth[r0:r1, c0:c1] = anew[r0 - top : r1 - top, c0 - left : c1 - left]


def _grown(
    z: F64, free: NDArray[np.bool_], seed: tuple[int, int], reach: int, cell: float, tolerance: float
) -> tuple[Window, NDArray[np.bool_]]:
    """(window of the image, mask in it) of what a plane takes about a seed.

    It starts from the largest square about the seed, its side doubled up to `reach`, that is planar as a whole. The
    window is widened until nothing reaches its rim, so that the result is that of the whole image. Most planes of
    clutter are small, and looking at all of the image for each of them takes far longer.
    """
    side = 1
    for wider in (reach >> k for k in range(reach.bit_length() - 2, -1, -1)):
        square = _square(seed, wider)
        near = free[square]
        if _off(z[square], _fit(z[square], near), cell)[near].max() >= tolerance:
            break
        side = wider
    wide = 2 * side + 8
    while True:
        low = np.maximum(np.subtract(seed, wide), 0)
        high = np.minimum(np.add(seed, wide + 1), z.shape)
        window = slice(low[0], high[0]), slice(low[1], high[1])
        place = (int(seed[0] - low[0]), int(seed[1] - low[1]))
        start = np.zeros(high - low, bool)
        start[_square(place, side)] = free[_square(seed, side)]
        rim = np.ones(high - low, bool)  # where the image goes on beyond the window
        rim[tuple(slice(int(a > 0), b - a - int(b < n)) for a, b, n in zip(low, high, z.shape, strict=True))] = False
        taken = _grow(z[window], free[window], start, place, cell, tolerance, rim)
        if taken is not None:
            return window, taken
        wide *= 2


def _square(middle: tuple[int, int], side: int) -> Window:
    """Window of the cells at most `side` from one."""
    row, column = (slice(max(at - side, 0), at + side + 1) for at in middle)
    return row, column


def from_corner(plane: F64, window: Window) -> F64:
    """A plane of the image, in cells counted from the corner of a window."""
    a, b, c = plane
    return np.array([a, b, c + a * window[1].start + b * window[0].start])


def _grow(
    z: F64,
    free: NDArray[np.bool_],
    taken: NDArray[np.bool_],
    seed: tuple[int, int],
    cell: float,
    tolerance: float,
    rim: NDArray[np.bool_],
) -> NDArray[np.bool_] | None:
    """The connected cells about the seed that lie on one plane, starting from the plane of those in `taken`; None where
    they get to the `rim`."""
    from scipy import ndimage

    for _ in range(6):
        pieces, _ = ndimage.label(free & (_off(z, _fit(z, taken), cell) < tolerance))
        grown = pieces == pieces[seed]
        if not pieces[seed] or (grown == taken).all():
            break
        if (grown & rim).any():
            return None
        taken = grown
    return taken


def heights(plane: F64, shape: tuple[int, int]) -> F64:
    """(rows, columns) z of a plane a b c."""
    rows, columns = np.indices(shape, sparse=True)
    return plane[0] * columns + plane[1] * rows + plane[2]


def misfit(z: F64, planes: F64) -> Misfit:
    """A function that turns plane indices (negative: any) and the (rows, columns) of their cells into metres that z is
    off there; of a whole image of indices without them."""

    def off(labels: I64, at: tuple[I64, I64] | None = None) -> F64:
        rows, columns = np.indices(z.shape) if at is None else at
        a, b, c = np.moveaxis(planes[np.maximum(labels, 0)], -1, 0)
        return np.abs(z[rows, columns] - a * columns - b * rows - c)

    return off


def spread(labels: I64, inside: NDArray[np.bool_], cost: Misfit, outside: F64 | None = None) -> I64:
    """Give every cell inside that has no label that of the neighbour which suits it best.

    A blurred edge between two faces is thereby cut half way up, where the true edge is. Only cells beside those that
    were decided last are looked at: on the ceiling of a corridor, most of the image is decided before it begins.

    Args:
        labels: (rows, columns), -1 where unlabelled.
        inside: (rows, columns) cells that want a label.
        cost: how ill labels suit cells (`misfit`).
        outside: (rows, columns) misfit of being no part of this at all, or None where that is no choice. Cells at the
            rim may choose it, and are -1 in the result.
    """
    from scipy import ndimage

    if not (labels >= 0).any():
        return labels
    if outside is not None:
        # Leaving is a choice only for what suits it better than the nearest label, which may still have to get there.
        near = ndimage.distance_transform_cdt(labels < 0, "taxicab", return_distances=False, return_indices=True)
        outside = np.where(outside < cost(labels[near[0], near[1]]), outside, np.inf)
    labels = np.pad(labels, 1, constant_values=-1)
    gone = np.pad(~inside, 1, constant_values=True)
    open_ = (labels == -1) & ~gone
    wide = labels.shape[1]
    shifts = np.array([-wide, wide, -1, 1])
    label, left, free = labels.ravel(), gone.ravel(), open_.ravel()  # views of the three
    beside = np.flatnonzero(ndimage.binary_dilation((labels >= 0) | (gone if outside is not None else False)) & open_)
    while len(beside):
        at = beside // wide - 1, beside % wide - 1
        best, choice = np.full(len(beside), np.inf), np.full(len(beside), -2)
        for shift in shifts:
            neighbour = label[beside + shift]
            value = np.where(neighbour >= 0, cost(neighbour, at), np.inf)
            better = value < best
            best, choice = np.where(better, value, best), np.where(better, neighbour, choice)
            if outside is not None:
                better = left[beside + shift] & (outside[at] < best)
                best, choice = np.where(better, outside[at], best), np.where(better, -1, choice)
        decided, choice = beside[choice != -2], choice[choice != -2]
        label[decided], left[decided], free[decided] = choice, choice == -1, False
        beside = np.unique(decided[:, None] + shifts)
        beside = beside[free[beside]]
    return labels[1:-1, 1:-1]


def _fit(z: F64, where: NDArray[np.bool_]) -> F64:
    """Least-squares a b c over the cells of a mask."""
    rows, columns = (np.arange(n) for n in z.shape)
    of_row, of_column, n = where.sum(1), where.sum(0), int(where.sum())
    r0, c0, mean = float(of_row @ rows) / n, float(of_column @ columns) / n, float(z.sum(where=where)) / n
    r, c, height = rows - r0, columns - c0, np.where(where, z - mean, 0.0)
    both = float(r @ (where @ c))
    moments = np.array([[of_column @ c**2, both], [both, of_row @ r**2]])
    a, b = np.linalg.lstsq(moments, [height.sum(0) @ c, height.sum(1) @ r], rcond=None)[0]
    return np.array([a, b, mean - a * c0 - b * r0])


def _off(z: F64, plane: F64, cell: float) -> F64:
    """(rows, columns) metres perpendicular to a plane."""
    return np.abs(z - heights(plane, (z.shape[0], z.shape[1]))) * _steepness(plane, cell)


def _steepness(plane: F64, cell: float) -> float:
    """z component of a plane's unit normal: turns vertical distances into perpendicular ones."""
    return float(1 / np.sqrt(1 + (plane[0] / cell) ** 2 + (plane[1] / cell) ** 2))


def _roughness(z: F64, cell: float, window: int) -> F64:
    """(rows, columns) RMS distance, metres, of a cell's window from its own plane; inf at rims and steps."""
    from scipy import ndimage

    known = np.isfinite(z)
    base = np.nanmean(z) if known.any() else 0.0
    full = np.where(known, z - base, 0.0)
    k = np.arange(window) - window // 2
    flat = np.ones(window)

    def moment(values: F64, along_row: F64, along_column: F64) -> F64:
        once = ndimage.correlate1d(values, along_column, axis=1, mode="constant")
        return ndimage.correlate1d(once, along_row, axis=0, mode="constant")

    n = window**2
    spread_ = window * float((k**2).sum())
    mean = moment(full, flat, flat) / n
    slope_c = moment(full, flat, k.astype(float)) / spread_
    slope_r = moment(full, k.astype(float), flat) / spread_
    square = moment(full**2, flat, flat) / n
    variance = square - mean**2 - (slope_c**2 + slope_r**2) * spread_ / n
    steep = np.sqrt(1 + (slope_c / cell) ** 2 + (slope_r / cell) ** 2)
    whole = moment(known.astype(float), flat, flat) > n - 0.5
    return np.where(whole, np.sqrt(np.maximum(variance, 0)) / steep, np.inf)
