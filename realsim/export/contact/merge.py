"""Parts whose hull adds nothing to the shape are made one: a frustum cut under each of its faces is one part again."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import areas, runs, sampled
from realsim.core.types import F64
from realsim.export.contact.base import Geom
from realsim.export.contact.polytope import Polytope, corners_of

ADDS = 0.004
"""Metres by which a hull may stand out of the shape; planes are fitted no more closely. On the true mesh of a rendered
capture, 30 prisms become 17 parts and the p95 stays at 1.6 mm. Where it was not set: with half of it a round tub of
thin walls has 92 parts for 51, a pallet 48 for 34, a spiral stair 14 for 12, a shelf of boards the same."""
FEW = 0.02
"""Share of a hull that may stand out by up to twice as much, so that no single place decides. Without it, where it was
not set, a round tub has 55 parts for 51, a spiral stair 14 for 12, a pallet 47 for 34; the farthest error is 4.3 for
7.3 mm, the same, and 0.1 for 1.5 mm."""
SPACING = 0.02
"""Metres between the samples on a hull; the balls of the measure are 2 cm across; and..."""
PLACES = 5000
"""...how many at most on a part: a large one is sampled more widely."""
ALIKE = 0.98
"""Cosine between faces that are one: its plane is that of the largest."""
AT_ONCE = 5000
"""Points times parts that are compared at a time, some 0.5 MB; the result does not depend on it."""
SOME = 8
"""Points that are looked at before the others, where one that is outside decides; the result does not depend on it."""
MOST_CORNERS = 64
"""Of one part; colliders on a GPU take no more."""


class Neighbours:
    """Bounds of parts, to find those that may meet one."""

    def __init__(self, parts: Iterable[Polytope]) -> None:
        bounds = np.array([(p.lower, p.upper) for p in parts]).reshape(-1, 2, 3)
        self.lower, self.upper = np.ascontiguousarray(bounds[:, 0].T), np.ascontiguousarray(bounds[:, 1].T)
        self.seen: dict[Any, Any] = {}
        """What was found of some of them already."""

    def update(self, i: int, part: Polytope | None) -> None:
        """A part that changed, or is gone."""
        self.lower[:, i], self.upper[:, i] = (np.inf, -np.inf) if part is None else (part.lower, part.upper)

    def of(self, low: F64, high: F64, but: int = -1) -> NDArray[np.int64]:
        """Those that meet a box."""
        meets = np.ones(self.lower.shape[1], bool)
        for k in range(3):
            meets &= (self.lower[k] <= high[k]) & (self.upper[k] >= low[k])
        if but >= 0:
            meets[but] = False
        return np.flatnonzero(meets)


class Whole:
    """What parts and the ground fill together."""

    def __init__(self, parts: list[Polytope], others: list[Geom]) -> None:
        """
        Args:
            others: geoms that are no parts: a floor.
        """
        parts = parts + [Polytope.of_box(g) for g in others if g.type == "box"]
        self.near = Neighbours(parts)
        self.planes = np.concatenate([np.zeros((0, 4)), *(part.planes for part in parts)])
        self.count = np.array([len(part.planes) for part in parts], np.int64)
        self.first = np.cumsum(self.count) - self.count
        self.ground = max((g.pos[2] for g in others if g.type == "plane"), default=-np.inf)

    def holds(self, points: F64, margin: float, but: float = 0.0) -> bool:
        """Whether points (N, 3), `but` for a share of them, lie inside or at most `margin` metres outside, and all at
        most twice that."""
        near, most = self._near(points, margin), but * len(points)
        if not most and len(points) > 2 * SOME and len(self._beyond(points[:: len(points) // SOME], near, margin, 0)):
            return False
        left = self._beyond(points, near, margin, most)
        if len(left) and len(left) <= most:
            left = self._beyond(left, self._near(points, 2 * margin), 2 * margin, 0)
        return not len(left)

    def _near(self, points: F64, margin: float) -> NDArray[np.int64]:
        """The parts about those of the points that are above the ground, first those that are likely to hold most."""
        above = points[points[:, 2] > self.ground + margin]
        if not len(above):
            return np.zeros(0, np.int64)
        low, high = above.min(0) - margin, above.max(0) + margin
        near = self.near.of(low, high)
        shared = np.minimum(self.near.upper[:, near].T, high) - np.maximum(self.near.lower[:, near].T, low)
        return near[np.argsort(-shared.prod(1), kind="stable")]

    def _beyond(self, points: F64, near: NDArray[np.int64], margin: float, most: float) -> F64:
        """Those of the points (N, 3) that lie more than `margin` metres outside; where it is `most` or fewer of them,
        some may not."""
        left = points[points[:, 2] > self.ground + margin]
        while len(near) and len(left) > most:
            some = 1 + AT_ONCE // len(left)
            count = self.count[near[:some]]
            planes = self.planes[runs(self.first[near[:some]], count)]
            off = planes[:, :3] @ left.T + planes[:, 3:]  # along the points, which are many, numpy is faster
            left = left[(np.maximum.reduceat(off, np.cumsum(count) - count, axis=0) > margin).all(0)]
            near = near[some:]
        return left

    def holds_hull(self, part: Polytope, margin: float, *within: Polytope) -> bool:
        """Whether a part stands out of the shape by at most `margin` metres, but for FEW of the places on its surface.

        Args:
            within: parts of the shape that it is made of.
        """
        points, triangles, _ = part.hull
        for one in within:
            triangles = triangles[~one.contains(points[triangles].reshape(-1, 3), 1e-6).reshape(-1, 3).all(1)]
        if not len(triangles) or not self.holds(points[triangles].mean(1), 2 * margin):  # most are refused here
            return not len(triangles)
        count = int(np.clip(areas(points, triangles).sum() / SPACING**2, 100, PLACES))
        for places, few in ((count // 10, 3 * FEW), (count, FEW)):  # a tenth of them tells of most
            if not self.holds(sampled(points, triangles, places, np.random.default_rng(0))[0], margin, few):
                return False
        return True


def merged(parts: list[Polytope], whole: Whole, adds: float = ADDS) -> list[Polytope | None]:
    """The same shape in fewer parts: each as it was, grown, or None where another has taken it in.

    Args:
        adds: metres by which a hull may stand out.
    """
    out: list[Polytope | None] = list(parts)
    near = Neighbours(parts)
    tried = np.zeros((len(parts), len(parts)), bool)
    changed = True
    while changed:
        changed = False
        for i, part in enumerate(out):
            if part is None:
                continue
            while (found := _partner(out, near, whole, i, adds, tried)) is not None:
                out[i] = found
                near.update(i, found)
                changed = True
                around = near.of(found.lower - adds, found.upper + adds, but=i).tolist()
                for j in _held(found, {j: other for j in around if (other := out[j]) is not None}, adds):
                    out[j] = None
                    near.update(j, None)
                tried[i] = tried[:, i] = False
    return [
        now if now is None or now is old else _cut_back(now, parts, adds) for now, old in zip(out, parts, strict=True)
    ]


def _held(part: Polytope, others: Mapping[int, Polytope], margin: float) -> list[int]:
    """Which of the others lie inside a part, or outside by at most `margin` metres."""
    if not others:
        return []
    first = part.contains(np.array([other.points[0] for other in others.values()]), margin)  # most are refused by this
    some = [k for k, near in zip(others, first, strict=True) if near]
    return [k for k in some if part.contains(others[k].points, margin).all()]


def _cut_back(part: Polytope, pieces: list[Polytope], most: float) -> Polytope:
    """A hull cut back to the faces of its pieces, the largest first, that it stands out of by at most twice `most`
    metres: they were fitted to the surface, while its corners are where two of the pieces ended a little apart."""
    from scipy.spatial import HalfspaceIntersection

    points, _, own = part.hull
    within = [pieces[k] for k in _held(part, dict(enumerate(pieces)), most)]
    size = np.concatenate([areas(*p.hull[:2]) for p in within])
    planes = np.concatenate([p.hull[2] for p in within])[np.argsort(-size, kind="stable")]
    planes = planes[(points @ planes[:, :3].T + planes[:, 3]).max(0) <= 2 * most]
    chosen: list[F64] = []
    for plane in planes:
        if not any(plane[:3] @ other[:3] > ALIKE for other in chosen):
            chosen.append(plane)
    rows = np.array([*chosen, *own])
    middle = points.mean(0)
    if (rows[:, :3] @ middle + rows[:, 3]).max() > -most:
        return Polytope.of_points("", points)
    corners = HalfspaceIntersection(rows, middle).intersections
    return Polytope.around(corners[np.unique(np.round(corners, 5), axis=0, return_index=True)[1]])


def _partner(
    parts: list[Polytope | None], near: Neighbours, whole: Whole, i: int, adds: float, tried: NDArray[np.bool_]
) -> Polytope | None:
    """The hull of a part and of one that it meets, if there is one that adds nothing.

    Args:
        tried: (N, N) where two parts as they are have none.
    """
    one = parts[i]
    assert one is not None
    for j in near.of(one.lower - adds, one.upper + adds, but=i):
        other = parts[j]
        if other is None or tried[i, j]:
            continue
        tried[i, j] = tried[j, i] = True
        halfway = (one.points[:, None] + other.points).reshape(-1, 3) / 2  # most are refused by these, without a hull
        if whole.holds(halfway[:: 1 + len(halfway) // 100], 2 * adds):
            hull = Polytope(corners_of(one.points, other.points))  # boxes are recognised when all are merged
            if len(hull.points) <= MOST_CORNERS and whole.holds_hull(hull, adds, one, other):
                return hull
    return None
