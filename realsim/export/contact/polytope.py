"""Convex parts with their faces: what boxes and convex meshes have in common."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import R_to_quat, cross, quat_to_R
from realsim.core.meshes import across, areas
from realsim.core.types import F64
from realsim.export.contact.base import Asset, Geom
from realsim.export.contact.outline import hull

ONE_PLANE = 1e-3
"""Cosine from 1, and metres, by which the triangles of a hull that lie in one face may differ."""
SQUARE = 1e-4
"""Metres by which corners may be off those of a box that stands for them."""
NARROW_BOX = 0.12
"""Metres: a narrower box is written as a convex mesh. MuJoCo (3.11 to 3.17) gives a capsule whose axis is in a box
one contact, at one of its ends: the other end sinks until a side is nearer than the top, and comes out there. Capsules
of 1 cm that land at 2 m/s fall through boxes of 4 to 12 cm (all that were tried), and through none of the same boxes as
meshes, down to 1 cm."""
SIGNS = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], float)


@dataclass(frozen=True, eq=False)
class Polytope:
    """The hull of some corners."""

    points: F64
    """(M, 3) metres."""
    box: Geom | None = None
    """The box that it is, if it is one."""

    @staticmethod
    def of_box(geom: Geom) -> Polytope:
        """The corners of a box."""
        return Polytope(np.array(geom.pos) + SIGNS * np.array(geom.size) @ quat_to_R(geom.quat).T, geom)

    @staticmethod
    def of_points(name: str, points: F64) -> Polytope:
        """The hull of points (M, 3), as a box where it is one."""
        return Polytope(points, _as_box(name, points))

    @staticmethod
    def around(*points: F64) -> Polytope:
        """The same of several arrays of points, with the corners of the hull alone."""
        return Polytope.of_points("", corners_of(*points))

    @cached_property
    def lower(self) -> F64:
        """(3,) lower corner of its bounds."""
        return np.asarray(self.points.min(0))

    @cached_property
    def upper(self) -> F64:
        """(3,) upper corner of its bounds."""
        return np.asarray(self.points.max(0))

    @cached_property
    def hull(self) -> tuple[F64, NDArray[np.int64], F64]:
        """((M, 3) corners, (K, 3) triangles of them, facing out, (K, 4) unit normal and offset of each)."""
        from scipy.spatial import ConvexHull

        middle = self.points.mean(0)
        made = ConvexHull(self.points - middle)
        normals = across(self.points, made.simplices)
        inward = (normals * made.equations[:, :3]).sum(1) < 0
        triangles = np.where(inward[:, None], made.simplices[:, ::-1], made.simplices).astype(np.int64)
        planes = made.equations.copy()
        planes[:, 3] -= planes[:, :3] @ middle
        return self.points, triangles, planes

    @cached_property
    def planes(self) -> F64:
        """(P, 4) of each face: unit normal and offset; inside, normal . x + offset <= 0."""
        return np.array([[*face.normal, face.offset] for face in self.faces])

    @cached_property
    def faces(self) -> tuple[Face, ...]:
        """Its faces, triangles of one plane together."""
        points, triangles, equations = self.hull
        order = np.argsort(-areas(points, triangles), kind="stable")  # large ones have the better normals
        normals, offsets = equations[:, :3], equations[:, 3]
        off = np.abs(normals @ points.T + offsets[:, None])
        alike = (off[:, triangles].max(2) < SQUARE) & (normals @ normals.T > 1 - ONE_PLANE)
        free = np.ones(len(order), bool)
        out = []
        for k in order:
            if not free[k]:
                continue
            same = free & alike[k]
            same[k] = True
            free &= ~same
            out.append(Face(normals[k], float(offsets[k]), points[np.unique(triangles[same])]))
        return tuple(out)

    def face_like(self, face: Face) -> Face | None:
        """Its face in the plane of another, if it has one there."""
        for own in self.faces:
            if own.normal @ face.normal > 1 - 1e-9 and abs(own.offset - face.offset) < SQUARE:
                return own
        return None

    def contains(self, points: F64, margin: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) lie inside, or outside by at most `margin` metres."""
        return np.asarray(self.depth(points) >= -margin)

    def depth(self, points: F64) -> F64:
        """(N,) metres from points (N, 3) inside to the nearest face; negative outside, from the plane farthest off."""
        return np.asarray(-(self.planes[:, :3] @ points.T + self.planes[:, 3:]).max(0))

    def about(self, points: F64, margin: float = 0.0) -> NDArray[np.int64]:
        """Which of points (N, 3) its bounds hold, or miss by at most `margin` metres."""
        here = np.arange(len(points))
        for k in range(3):  # numpy is slow along rows of three
            at = points[here, k]
            here = here[(at > self.lower[k] - margin) & (at < self.upper[k] + margin)]
        return here

    def section(self, face: Face, beyond: float) -> F64:
        """(K, 2) outline of this where the plane `beyond` metres outside another's face cuts it, in that face's plane;
        empty where it does not."""
        height = self.points @ face.normal + face.offset - beyond
        triangles = self.hull[1]
        start, end = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()  # every edge, once in each direction
        crosses = (height[start] > 0) & (height[end] <= 0)
        start, end = start[crosses], end[crosses]
        t = height[start] / (height[start] - height[end])
        return face.flat(self.points[start] + t[:, None] * (self.points[end] - self.points[start]))

    def part(self, name: str) -> tuple[Geom, Asset | None]:
        """Its geom, and the asset of that where it is no box."""
        if self.box is not None and self.box.size is not None and 2 * min(self.box.size) >= NARROW_BOX:
            return replace(self.box, name=name), None
        return Geom(name, "mesh", asset=name), Asset.of_points(name, self.points)


@dataclass(frozen=True, eq=False)
class Face:
    """A face of a convex part."""

    normal: F64
    """(3,) unit, outward."""
    offset: float
    """normal . x + offset = 0 on it."""
    corners: F64
    """(M, 3) metres."""

    @cached_property
    def axes(self) -> F64:
        """(2, 3) unit vectors in its plane."""
        u = cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()])
        u /= np.linalg.norm(u)
        return np.stack([u, cross(self.normal, u)])

    @cached_property
    def outline(self) -> F64:
        """(K, 2) its corners in its plane, counter-clockwise."""
        return hull(self.flat(self.corners))

    def flat(self, points: F64) -> F64:
        """(N, 2) of points (N, 3), dropped into its plane."""
        return np.asarray(points @ self.axes.T)

    def lifted(self, flat: F64, beyond: float = 0.0) -> F64:
        """(N, 3) of points (N, 2) in its plane, `beyond` metres outside."""
        return np.asarray(flat @ self.axes + (beyond - self.offset) * self.normal)


def corners_of(*points: F64) -> F64:
    """(M, 3) corners of the hull of several arrays of points."""
    from scipy.spatial import ConvexHull

    every = np.concatenate(points)
    return np.asarray(every[ConvexHull(every - every.mean(0)).vertices])


def _as_box(name: str, points: F64) -> Geom | None:
    """The box of which the points (M, 3) are the corners, if there is one."""
    faces = Polytope(points).faces
    if len(faces) != 6:
        return None
    u = faces[0].normal
    v = min((f.normal for f in faces[1:]), key=lambda n: abs(float(n @ u)))
    v = v - (v @ u) * u
    v /= np.linalg.norm(v)
    axes = np.stack([u, v, np.cross(u, v)])
    # Axes nearest to the world's in their order, so that a box that stands straight is written without a turn.
    axes = axes[[int(np.abs(axes[:, k]).argmax()) for k in range(3)]] if _straight(axes) else axes
    if _straight(axes):
        axes = axes * np.sign(np.diagonal(axes))[:, None]
    if np.linalg.det(axes) < 0:
        axes[2] = -axes[2]
    along = points @ axes.T
    low, high = along.min(0), along.max(0)
    centre, half = (low + high) / 2, (high - low) / 2
    corners = centre + SIGNS * half
    if np.linalg.norm(along[:, None] - corners[None], axis=2).min(1).max() > SQUARE:
        return None
    x, y, z = (float(c) for c in centre @ axes)
    a, b, c, d = (float(q) for q in R_to_quat(axes.T))
    return Geom(name, "box", (x, y, z), (a, b, c, d), (float(half[0]), float(half[1]), float(half[2])))


def _straight(axes: F64) -> bool:
    """Whether each of the world's axes is nearest to another of these."""
    return len({int(np.abs(axes[:, k]).argmax()) for k in range(3)}) == 3
