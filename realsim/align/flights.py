"""Flights of stairs: level faces too narrow for a platform that rise one after another.

A tread is hardly deeper than a foot, so alone it is an obstacle like any other. What makes it a place to stand is the
flight: from the ground up, each face a step's height above the last and right beside it.

From below, only the front edge of a tread is seen. A level edge as wide as a person, evenly above the last, is a tread
too: it reaches back to the next edge, or nobody could climb there. The last one is as deep as the one before.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from realsim.align.cloud import VOXEL, Cloud
from realsim.align.faces import LEVEL_DEG, connected, plane_of, seen_area, smooth_regions
from realsim.core.types import F64, Bool

Indices = NDArray[np.intp]

DEEP, WIDE = 0.15, 0.40
"""Metres: a tread's least depth (a foot and no more) and width (a person's)."""
FILLED = 0.6
"""Least share of its own rectangle that a seen tread fills."""
RISE = (0.08, 0.26)
"""Metres between a tread and the next. Building codes allow 10 to 22 cm."""
BESIDE = 0.12
"""Metres in the plan between a tread and the next: a nosing may hide so much of the lower one's back."""
LEAST = 3
"""Treads that make a flight; two may be anything."""
# The figures of edges, from here on, were set on one real stair (pcl_kinect_stairs: 8 of 8 treads, 0 without). There
# is no second real one. Made stairs come out whole; made shelves and boards, two rendered courses and a LiDAR room have
# none.
LEAST_EDGES = 4
"""The same where edges are among them: a shelf or a chair's rungs have fewer that also go on."""
EVEN = 0.04
"""Metres that the rise to an edge may differ from the mean rise below it. The eight of a real stair: up to 0.03."""
GOING = (0.08, 0.35)
"""Metres in the plan from one front edge to the next, at the middle; shelves stand above each other."""
CLEAR, ABOUT = 0.10, 0.06
"""Metres: an edge's top has nothing above it for so far up, and so far about it: it ends there, as no wall does."""
JOIN, BUMPS = 0.045, 0.02
"""Metres between the points of one edge, twice what it may be in height, and the deviation of their heights."""


@dataclass(frozen=True)
class Tread:
    """A place to stand in a flight."""

    points: Indices
    """Of the cloud: its face, or its front edge."""
    outline: F64 | None = None
    """(K, 2) plan of one whose edge was seen and whose top was not, or only in part."""


def treads(cloud: Cloud) -> list[Tread]:
    """The treads of the longest flight that begins at the ground, from below; empty if there is none.

    The cloud is levelled: z up, ground at z = 0.
    """
    up = cloud.normals[:, 2] if cloud.oriented else np.abs(cloud.normals[:, 2])
    level = np.flatnonzero((up > 0.9) & (cloud.points[:, 2] > RISE[0]))
    faces = [level[r] for r in smooth_regions(cloud.points[level], cloud.voxel, DEEP * WIDE * FILLED)]
    faces = [f for f in faces if _is_tread(cloud, f)]
    flight = _longest(cloud, faces, even=False)
    if len(flight) < LEAST or not _goes_on(np.array([cloud.points[f, :2].mean(0) for f in flight])):
        flight = []
    on_faces = np.isin(np.arange(len(cloud)), np.concatenate([*faces, np.zeros(0, np.intp)]))
    edges = [e for e in _edges(cloud) if not on_faces[e].any()]
    longer = _longest(cloud, faces + edges, even=True)
    if len(longer) <= max(len(flight), LEAST_EDGES - 1):
        return [Tread(f) for f in flight]
    fronts = _fronts([cloud.points[f, :2] for f in longer])
    goings = np.linalg.norm(np.diff(fronts.mean(1), axis=0), axis=1)
    if goings.min() < GOING[0] or goings.max() > GOING[1] or not _goes_on(fronts.mean(1)):
        return [Tread(f) for f in flight]
    seen = {id(f) for f in faces}
    return [
        Tread(f, None if id(f) in seen else _outline(cloud.points[f, :2], fronts[k], fronts[k + 1]))
        for k, f in enumerate(longer)
    ]


def _longest(cloud: Cloud, faces: list[Indices], *, even: bool) -> list[Indices]:
    """The longest flight of some of these faces, from below."""
    heights = np.array([np.median(cloud.points[f, 2]) for f in faces])
    best: dict[int, list[int]] = {}  # the longest flight that ends with each face
    for k in np.argsort(heights, kind="stable").tolist():
        below: list[list[int]] = [[]] if heights[k] < RISE[1] else []
        for j, flight in best.items():
            rise, mean = heights[k] - heights[j], heights[j] / len(flight)
            fits = RISE[0] < rise < RISE[1] and not (even and abs(rise - mean) > EVEN)
            if fits and _apart(cloud, faces[j], faces[k]) < (GOING[1] if even else BESIDE):
                below.append(flight)
        if below:
            best[k] = [*max(below, key=len), k]
    return [faces[k] for k in max(best.values(), key=len, default=[])]


def _is_tread(cloud: Cloud, face: Indices) -> bool:
    import cv2

    points = cloud.points[face]
    slope, _ = plane_of(points)
    _, sides, _ = cv2.minAreaRect(points[:, :2].astype(np.float32))
    deep, wide = sorted(s + cloud.voxel for s in sides)
    seen = seen_area(points[:, :2], cloud.voxel)
    level = np.degrees(np.arctan(np.hypot(*slope))) < LEVEL_DEG
    return bool(level and deep > DEEP and wide > WIDE and seen > FILLED * deep * wide)


def _edges(cloud: Cloud) -> list[Indices]:
    """Points of each level edge as wide as a person: of the ends of what stands or hangs there, seen from anywhere.

    A board of 5 cm cannot be distinguished from a wall in voxels coarser than that of views.
    """
    import cv2

    if cloud.voxel > VOXEL:
        return []
    top = _tops(cloud.points, cloud.voxel)
    found = []
    for part in connected(cloud.points[top], JOIN, 2.0, 12):
        points = cloud.points[top[part]]
        z, middle = points[:, 2], points[:, :2].mean(0)
        wide = max(cv2.minAreaRect(points[:, :2].astype(np.float32))[1]) + cloud.voxel
        along = np.linalg.svd(points[:, :2] - middle, full_matrices=False)[2][0]
        slope = np.polyfit((points[:, :2] - middle) @ along, z, 1)[0]
        if (
            wide > WIDE
            and 1.4826 * np.median(np.abs(z - np.median(z))) < BUMPS
            and np.degrees(np.arctan(abs(slope))) < LEVEL_DEG
        ):
            found.append(top[part])
    return found


def _tops(points: F64, voxel: float) -> Indices:
    """Those of the points above the first rise that have nothing above them, see CLEAR and ABOUT."""
    cell = np.floor((points - points.min(0)) / voxel).astype(np.int64) + 8
    size = cell.max(0) + 16
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    below = np.unique(np.concatenate([key - k for k in range(2, round(CLEAR / voxel) + 1)]))
    top = np.flatnonzero(points[:, 2] > RISE[0])
    top = top[~_among(key[top] + 1, np.unique(key))]
    reach = round(ABOUT / voxel)
    for i, j in np.argwhere(np.hypot(*np.indices((2 * reach + 1,) * 2) - reach) <= reach) - reach:
        top = top[~_among(key[top] + (i * size[1] + j) * size[2], below)]
    return top


def _among(values: Indices, ordered: Indices) -> Bool:
    """(M,) which values are among others (K,) in rising order, none of them twice."""
    place = np.minimum(np.searchsorted(ordered, values), len(ordered) - 1)
    return np.asarray(ordered[place] == values)


def _fronts(faces: list[F64]) -> F64:
    """(K + 1, 2, 2) front edge of each face (M, 2) of a flight in the plan, from one side of it to the other, and of
    the one that would follow."""
    fronts: list[F64] = []
    for k, xy in enumerate(faces):
        # The first one's front is away from the second, each other's toward the front of the one below.
        front = _front(xy, 2 * xy.mean(0) - faces[1].mean(0) if k == 0 else fronts[-1].mean(0))
        if fronts and (front[1] - front[0]) @ (fronts[-1][1] - fronts[-1][0]) < 0:
            front = front[::-1]
        fronts.append(front)
    # A flight goes on as it came: by the same turn and step.
    a, b = (f @ [1, 1j] for f in fronts[-2:])
    turn = (b[1] - b[0]) / (a[1] - a[0])
    turn /= abs(turn)
    c = b.mean() + (b.mean() - a.mean()) * turn + (b - b.mean()) * turn
    return np.stack([*fronts, np.column_stack([c.real, c.imag])])


def _front(xy: F64, toward: F64) -> F64:
    """(2, 2) ends of the edge of points (M, 2) toward a place: a line through the foremost of each 4 cm along them."""
    from scipy.stats import siegelslopes

    middle = xy.mean(0)
    along = np.linalg.svd(xy - middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    across *= np.sign((toward - middle) @ across)
    s, t = (xy - middle) @ along, (xy - middle) @ across
    section = np.floor(s / 0.04).astype(int)
    foremost = np.array([np.flatnonzero(section == k)[np.argmax(t[section == k])] for k in np.unique(section)])
    slope, base = siegelslopes(t[foremost], s[foremost])[:2]
    on = foremost[np.abs(t[foremost] - slope * s[foremost] - base) < BUMPS]
    ends = np.array([s[on].min(), s[on].max()])
    return middle + ends[:, None] * along + (slope * ends + base)[:, None] * across


def _outline(xy: F64, front: F64, following: F64) -> F64:
    """(K, 2) of a tread of which points (M, 2) are seen: from its front edge back to the next one's, or as far as it is
    seen where that is farther."""
    import cv2

    back = _front(xy, 2 * xy.mean(0) - front.mean(0))
    depths = [np.linalg.norm(edge.mean(0) - front.mean(0)) for edge in (following, back)]
    corners = np.concatenate([front, following, *([back] if depths[1] > depths[0] else [])])
    return cv2.convexHull(corners.astype(np.float32))[:, 0].astype(np.float64)


def _apart(cloud: Cloud, a: Indices, b: Indices) -> float:
    """Metres between two faces in the plan."""
    from scipy.spatial import cKDTree

    return float(cKDTree(cloud.points[a, :2]).query(cloud.points[b, :2])[0].min())


def _goes_on(middles: F64) -> bool:
    """Whether the way up (K, 2) turns by less than 120 degrees at every tread: winding, but not back and forth."""
    steps = np.diff(middles, axis=0)
    return all(float(a @ b) > -0.5 * float(np.linalg.norm(a) * np.linalg.norm(b)) for a, b in pairwise(steps))
