"""Outlines of regions on a grid, and their division into convex polygons."""

import heapq
import itertools

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F64

Edge = tuple[int, int]
Line = tuple[F64, F64]  # a point and a unit direction
PARALLEL = np.sin(np.radians(15))
FARTHEST = 3.0  # tolerances
SHORT = 7.0  # cells: shorter sides may be what is left of a corner
AT_ONCE = 1_000_000  # pairs of a point and a side that are held at once: some 50 MB
ROUND = 2.5  # tolerances by which a corner may stand out from a trace that rounds it


COARSER = (1.0, 1.75, 2.5, 4.0)  # times the tolerance: simplifications that are tried


def outlines(mask: NDArray[np.bool_], tolerance: float) -> list[F64]:
    """Closed outlines of a region, simplified: [(M, 2) row, column in cells], outer rings and holes.

    Args:
        mask: (rows, columns).
        tolerance: cells by which a tenth of the traced outline may lie farther off the simplified one; nothing lies
            farther off than FARTHEST times that.
    """
    from scipy import ndimage
    from skimage.measure import find_contours

    # A little blur turns the staircase of an oblique edge into a line; half way down is where the edge was.
    soft = ndimage.gaussian_filter(np.pad(mask, 3).astype(float), 0.7)
    rings = []
    for contour in find_contours(soft, 0.5):
        ring = _fewest_corners(contour[:-1] - 3, tolerance)
        if len(ring) >= 3 and abs(area(ring)) > 1.0:
            rings.append(ring)
    return rings


def _fewest_corners(trace: F64, tolerance: float) -> F64:
    """The polygon with the fewest corners that stays near a traced ring; of several, the nearest."""
    start = int(np.argmax(((trace - trace.mean(0)) ** 2).sum(1)))
    closed = np.roll(trace, -start, axis=0)[[*range(len(trace)), 0]]
    stays, fitted = _douglas_peucker(closed, COARSER[0] * tolerance), dict[Edge, Line]()
    rings = [_simplified(closed, stays, factor * tolerance, fitted) for factor in COARSER]
    best, nearest = rings[0], np.inf
    for ring in sorted(rings, key=len):
        if len(ring) > len(best):
            break
        if len(ring) >= 3:
            off = distance(trace, ring)
            near = off.max() < FARTHEST * tolerance and np.percentile(off, 90) < tolerance
            if near and off.mean() < nearest:
                best, nearest = ring, off.mean()
    return best


def _simplified(closed: F64, stays: F64, tolerance: float, fitted: dict[Edge, Line]) -> F64:
    """Douglas-Peucker from the two farthest points, then every side fitted to the points that it stands for, and
    corners that were cut or rounded made sharp.

    Args:
        stays: tolerances up to which each point of the closed ring stays. fitted: sides between two of them.
    """
    place = np.flatnonzero(stays > tolerance).tolist()
    corners = closed[place[:-1]]
    if len(corners) < 3:
        return corners
    for side in itertools.pairwise(place):
        if side not in fitted:
            fitted[side] = _line(closed[side[0] : side[1] + 1])
    lines = [fitted[side] for side in itertools.pairwise(place)]
    corners, lines = _sharpen(closed[:-1], corners, lines, tolerance)
    out = []
    for k, corner in enumerate(corners):
        met = _meet(lines[k - 1], lines[k])
        out.append(met if met is not None and np.hypot(*(met - corner)) < 2 * tolerance else corner)
    return np.array(out)


def _line(points: F64) -> Line:
    """The line that fits a piece of a trace best; its ends, where the trace cuts corners short, do not count."""
    inner = points[2:-2] if len(points) > 8 else points
    middle = inner.mean(0)
    x, y = (inner - middle).T
    along = np.arctan2(2 * (x @ y), x @ x - y @ y) / 2  # of the larger principal axis
    return middle, np.array([np.cos(along), np.sin(along)])


def _sharpen(ring: F64, corners: F64, lines: list[Line], tolerance: float) -> tuple[F64, list[Line]]:
    """Leave out short sides whose neighbours, drawn on, meet near the traced ring: side k runs from corner k to
    k + 1. A mesh rounds its corners; the thing itself rarely does."""
    k = 0
    while k < len(corners) and len(corners) > 3:
        n = len(corners)
        after = (k + 1) % n
        short = np.hypot(*(corners[after] - corners[k])) < SHORT
        met = _meet(lines[k - 1], lines[after]) if short else None
        if met is not None and np.linalg.norm(ring - met, axis=1).min() < ROUND * tolerance:
            corners = corners.copy()
            corners[after] = met
            corners = np.delete(corners, k, 0)
            lines = lines[:k] + lines[k + 1 :]
            k = max(k - 1, 0)
        else:
            k += 1
    return corners, lines


def distance(points: F64, ring: F64) -> F64:
    """(N,) distance of points (N, 2) from the sides of a ring (M, 2)."""
    x, y = ring.T
    dx, dy = sides(ring).T
    length = np.maximum(dx * dx + dy * dy, 1e-18)
    out = np.empty(len(points))
    some = max(1, AT_ONCE // len(ring))  # the outline of a whole corridor has tens of thousands of points
    for k in range(0, len(points), some):
        across, up = points[k : k + some, :1] - x, points[k : k + some, 1:] - y
        t = np.clip((across * dx + up * dy) / length, 0, 1)
        out[k : k + some] = ((across - t * dx) ** 2 + (up - t * dy) ** 2).min(1)
    return np.sqrt(out)


def _douglas_peucker(points: F64, tolerance: float) -> F64:
    """(N,) metres by which a line may move for each of its points to stay (1973); 0 where that is `tolerance` or less.
    The points that stay at one tolerance stay at every smaller one."""
    stays = np.zeros(len(points))
    stays[[0, -1]] = np.inf
    open_ = [(0, len(points) - 1, np.inf)]
    while open_:
        a, b, most = open_.pop()
        if b - a < 2:
            continue
        (x, y), (dx, dy) = points[a + 1 : b].T - points[a, :, None], points[b] - points[a]
        length = float(np.hypot(dx, dy))
        # A closed ring starts and ends at one point.
        off = np.abs(dx * y - dy * x) / length if length > 1e-12 else np.hypot(x, y)
        far = int(np.argmax(off))
        if off[far] > tolerance:
            middle = a + 1 + far
            stays[middle] = most = min(most, float(off[far]))
            open_ += [(a, middle, most), (middle, b, most)]
    return stays


def _meet(one: Line, two: Line) -> F64 | None:
    """Where two lines cross; None where they are within 15 degrees of parallel."""
    (p, u), (q, v) = one, two
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) < PARALLEL:
        return None
    d = q - p
    return p + (d[0] * v[1] - d[1] * v[0]) / cross * u


def area(ring: F64) -> float:
    """Signed area of a ring (M, 2)."""
    (x, y), (dx, dy) = ring.T, sides(ring).T
    return float(0.5 * (x @ dy - y @ dx))


def sides(ring: F64) -> F64:
    """(M, 2) from each corner of a ring to the next; `np.roll` takes several times as long."""
    return np.concatenate([ring[1:], ring[:1]]) - ring


def convex_parts(rings: list[F64], tolerance: float) -> list[F64]:
    """Divide a polygon with holes into few convex polygons.

    Triangles are merged, the pair that bulges least first, as long as the merged piece's hull leaves the piece by at
    most `tolerance` (with a tolerance of 0 this is Hertel and Mehlhorn's method, at most four times the fewest).

    Args:
        rings: outer rings and holes (M, 2), any orientation, even-odd.

    Returns:
        [(M, 2) counter-clockwise].
    """
    from manifold3d import CrossSection, FillRule, triangulate

    section = CrossSection([np.asarray(r) for r in rings], FillRule.EvenOdd)
    polygons = [np.asarray(p, float) for p in section.to_polygons()]
    if not polygons:
        return []
    points = np.concatenate(polygons)
    pieces: list[set[Edge]] = []
    for a, b, c in np.asarray(triangulate([p.astype(np.float32) for p in polygons])).tolist():
        if abs(area(points[[a, b, c]])) > 1e-12:
            pieces.append({(a, b), (b, c), (c, a)})
    owner: dict[Edge, int] = {edge: i for i, piece in enumerate(pieces) for edge in piece}
    bulge = {e: _bulge(points, pieces, owner, e) for e in owner if e[::-1] in owner and e[0] < e[1]}
    waiting = [(by, edge) for edge, by in bulge.items()]
    heapq.heapify(waiting)
    while waiting and waiting[0][0] <= tolerance:
        by, edge = heapq.heappop(waiting)
        if bulge.get(edge) != by:  # it is gone, or was found to bulge otherwise since
            continue
        keep, lose = owner[edge], owner[edge[::-1]]
        merged = _union(pieces[keep], pieces[lose])
        inner = (pieces[keep] | pieces[lose]) - merged
        pieces[keep], pieces[lose] = merged, set()
        for e in inner:
            bulge.pop(e, None)
            owner.pop(e, None)
        owner |= dict.fromkeys(merged, keep)
        for e in merged:
            key = e if e[0] < e[1] else e[::-1]
            if key in bulge:
                bulge[key] = _bulge(points, pieces, owner, key)
                heapq.heappush(waiting, (bulge[key], key))
    made = [hull(points[[a for a, _ in sorted(piece)]]) for piece in pieces if piece]
    return [part for part in made if len(part)]


def hull(points: F64) -> F64:
    """(M, 2) convex hull, counter-clockwise; (0, 2) of points on one line (Andrew 1979; of the few points of an outline
    much faster than Qhull)."""
    along = points[np.lexsort(points.T[::-1])].tolist()
    chain: list[list[float]] = []
    for way in (along, along[::-1]):
        start = len(chain)
        for p in way:
            while len(chain) > start + 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 1e-12:
                    break
                chain.pop()
            chain.append(p)
        del chain[-1:]
    return np.array(chain) if len(chain) > 2 else np.zeros((0, 2))


def _union(one: set[Edge], two: set[Edge]) -> set[Edge]:
    both = one | two
    return {e for e in both if e[::-1] not in both}


def _bulge(points: F64, pieces: list[set[Edge]], owner: dict[Edge, int], edge: Edge) -> float:
    """How far the hull of two merged pieces leaves them: the deepest dent of their common outline."""
    ring = _union(pieces[owner[edge]], pieces[owner[edge[::-1]]])
    corners = points[sorted({a for a, _ in ring})]
    outer = hull(corners)
    if not len(outer):
        return 0.0
    side = sides(outer)
    normal = np.stack([side[:, 1], -side[:, 0]], 1) / np.maximum(np.linalg.norm(side, axis=1), 1e-12)[:, None]
    depth = -((corners[:, None, :] - outer[None]) * normal[None]).sum(2)  # how far inside each side of the hull
    return float(depth.min(1).max())
