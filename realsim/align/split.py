"""One level region into the faces that a foot can stand on: cut at steps, and at necks narrower than a platform.

Neighbouring cells of nearly one height run together easily: a stake beside the platform, a box against it that is a
centimetre lower, a row of stakes. Two things tell them apart. A step, even of a few times the noise, is a line along
which the mean heights on both sides differ. And a platform has room for a disc of its least width everywhere, what
only touches it does not: an opening by that disc (Serra 1982, chapter 2) removes whatever is narrower.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64, Bool

RADIUS = 0.12
"""Metres: the disc, with the cell in its middle 26 cm wide, a little less than the narrowest platform (30 cm)."""
APART = 0.06
"""Metres from a line to the middles of what is compared on both sides."""
LEAST_STEP = 0.006
"""Metres between the means on both sides of a line that make it an edge..."""
CERTAIN = 6.0
"""...if they also differ by this many times the usual difference of means."""
LEAST_EDGE = 0.16
"""Metres of a line of steps; shorter ones are noise."""
HOLE = 0.016
"""Square metres: smaller gaps in what was seen do not divide a face."""
MARGIN = 12
"""Empty cells about the grid, more than any window or disc reaches."""


def split(points: F64, cell: float = 0.02) -> list[NDArray[np.intp]]:
    """Indices of the points (M, 3), `cell` metres apart, of each face. What is too narrow for one is in none."""
    from scipy.ndimage import binary_erosion, distance_transform_edt, label

    cells = np.floor((points[:, :2] - points[:, :2].min(0)) / cell).astype(np.int64) + MARGIN
    shape = tuple(cells.max(0) + MARGIN + 1)
    seen, height = _heights(points, cells, shape)
    area = _filled(seen, cell)
    radius = max(2, round(RADIUS / cell))
    r, c = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disc = r**2 + c**2 <= (radius + 0.5) ** 2
    cores, count = label(binary_erosion(area & ~_steps(seen, height, cell), disc), np.ones((3, 3)))
    if not count:
        return []
    distance, nearest = distance_transform_edt(cores == 0, return_indices=True)
    owner = cores[tuple(nearest)]
    face = np.where(area & (distance <= radius + 0.5), owner, 0)
    # The disc rounds corners off: what lies within the rectangle about a nearly rectangular face belongs to it.
    spare = area & (face == 0) & (distance < 1.5 * radius)
    rows, columns = np.nonzero(spare)
    for k in range(1, count + 1):
        mine = owner[rows, columns] == k
        inside = _in_rectangle(np.argwhere(face == k), np.column_stack([rows[mine], columns[mine]]), radius)
        face[rows[mine][inside], columns[mine][inside]] = k
    member = face[tuple(cells.T)]
    return [np.flatnonzero(member == k) for k in range(1, count + 1)]


def _heights(points: F64, cells: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[Bool, F64]:
    """Which cells hold points, and the mean height over the region's plane in each (0 where there is none)."""
    A = np.column_stack([points[:, :2], np.ones(len(points))])
    over = points[:, 2] - A @ np.linalg.lstsq(A, points[:, 2], rcond=None)[0]
    flat = cells[:, 0] * shape[1] + cells[:, 1]
    count = np.bincount(flat, minlength=shape[0] * shape[1])
    total = np.bincount(flat, over, minlength=shape[0] * shape[1])
    return (count > 0).reshape(shape), (total / np.maximum(count, 1)).reshape(shape)


def _filled(seen: Bool, cell: float) -> Bool:
    """The seen cells and the small gaps between them."""
    from scipy.ndimage import binary_closing, label

    closed = np.asarray(binary_closing(seen, np.ones((3, 3))), bool)
    gaps, _ = label(~closed)
    size = np.bincount(gaps.ravel())
    return closed | ((size * cell**2 < HOLE)[gaps] & ~closed)


def _steps(seen: Bool, height: F64, cell: float) -> Bool:
    """Cells on a line along which the surface steps up or down."""
    from scipy.ndimage import label, uniform_filter

    weight = uniform_filter(seen.astype(float), 3)
    mean = np.divide(uniform_filter(height, 3), weight, out=np.zeros_like(height), where=weight > 0)
    known = weight > 0.5
    edge = np.zeros(seen.shape, bool)
    far = max(2, round(APART / cell))
    near = max(2, round(APART / cell / np.sqrt(2)))
    for way in ((far, 0), (0, far), (near, near), (near, -near)):
        both = _shifted(known, way) & _shifted(known, (-way[0], -way[1]))
        step = np.where(both, np.abs(_shifted(mean, way) - _shifted(mean, (-way[0], -way[1]))), 0)
        usual = 1.4826 * float(np.median(step[both & seen])) if (both & seen).any() else 0.0
        unit = (int(np.sign(way[0])), int(np.sign(way[1])))
        crest = (step >= _shifted(step, unit)) & (step >= _shifted(step, (-unit[0], -unit[1])))
        edge |= crest & (step > max(LEAST_STEP, CERTAIN * usual))
    lines, _ = label(edge, np.ones((3, 3)))
    return edge & (np.bincount(lines.ravel()) * cell >= LEAST_EDGE)[lines]


def _shifted(a: NDArray[Any], by: tuple[int, int]) -> NDArray[Any]:
    """a[row + by[0], column + by[1]] at every cell; the grid's empty margin is wider than any shift."""
    return np.roll(a, (-by[0], -by[1]), (0, 1))


def _in_rectangle(face: NDArray[np.int64], cells: NDArray[np.int64], radius: int) -> Bool:
    """Which cells lie in the least rectangle about a face's cells; none if the face is no rectangle."""
    import cv2

    if not len(face) or not len(cells):
        return np.zeros(len(cells), bool)
    (centre, sides, turn), size = cv2.minAreaRect(face.astype(np.float32)), len(face)
    across, along = sides[0] + 1, sides[1] + 1
    lost = (4 - np.pi) * radius**2  # by the rounded corners
    if size + lost < 0.9 * across * along:
        return np.zeros(len(cells), bool)
    angle = np.radians(turn)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    off = np.abs((cells - np.array(centre)) @ axes.T)
    return np.asarray((off[:, 0] <= across / 2) & (off[:, 1] <= along / 2))
