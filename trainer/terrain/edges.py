"""Edges of footholds: where a sole can slip off. The reward for placing feet looks at them (the paper's appendix)."""

import numpy as np

from realsim.core.geometry import make_T, quat_to_R, transform
from realsim.core.meshes import mesh_of
from trainer.terrain.base import F64, Box, Terrain
from trainer.terrain.shapes import QUADS, corners

_STEP = 0.02
"""Metres between the points at which an edge is tested for being buried."""
_SKIN, _SCAN_SKIN = 0.006, 0.015
"""Metres: an edge beyond which another part lies at most this far below is no edge (of exact boxes, of a scan)."""
_COPLANAR = 0.003
"""Metres: hull triangles this close to one plane are one face; parts of a scan are not flatter than that."""
_UPWARD = 0.5
"""A face counts as a foothold from this z of its normal on (60 degrees)."""


class Convex:
    """A convex part as its faces: corner rings, and half-spaces `normals @ x <= offsets`."""

    def __init__(self, rings: list[F64]) -> None:
        self.rings = rings
        normals = np.array([_normal(r) for r in rings])
        middle = np.mean(np.vstack(rings), axis=0)
        outward = np.sign([n @ (r[0] - middle) for n, r in zip(normals, rings, strict=True)])
        self.normals: F64 = normals * outward[:, None]
        self.offsets: F64 = np.array([n @ r[0] for n, r in zip(self.normals, rings, strict=True)])

    def contains(self, points: F64, margin: float) -> np.ndarray:
        """(N,) whether points (N, 3) lie inside, or at most `margin` metres outside."""
        return np.all(points @ self.normals.T <= self.offsets + margin, axis=1)


def feature_edges(terrain: Terrain) -> F64:
    """(E, 2, 3) end points, metres, of the edges at which a foothold ends; joints between level parts are left out.

    Both for exact boxes and for the convex parts of a reconstructed scene; a height field's parts give none.
    """
    parts = convex_parts(terrain)
    skin = _SKIN if terrain.contact is None else _SCAN_SKIN
    found = [edge for i, part in enumerate(parts) for edge in _open_edges(i, part, parts, skin)]
    return np.array(found) if found else np.zeros((0, 2, 3))


def convex_parts(terrain: Terrain) -> list[Convex]:
    """The terrain's contact geometry as convex parts."""
    if terrain.contact is None:
        return [_of_box(b) for b in terrain.boxes]
    # Box and mesh geoms of the compiled specification, those that collide; meshes as their hulls.
    import mujoco

    model = terrain.contact.compile()
    parts = []
    for i in range(model.ngeom):
        if not (model.geom_contype[i] or model.geom_conaffinity[i]):
            continue
        T = make_T(quat_to_R(model.geom_quat[i]), model.geom_pos[i])
        if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX:
            parts.append(_of_box(Box(2 * model.geom_size[i], T)))
        elif model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH:
            parts.append(_hull(transform(T, mesh_of(model, model.geom_dataid[i])[0])))
    return parts


def _of_box(box: Box) -> Convex:
    points = corners(box)
    return Convex([points[quad] for quad in QUADS])


def _hull(points: F64) -> Convex:
    """The hull with nearly coplanar triangles joined into rings, the largest first."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    triangles = points[hull.simplices]
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    left = np.ones(len(area), bool)
    rings = []
    while left.any():
        normal, offset = np.split(hull.equations[np.argmax(np.where(left, area, -1.0))], [3])
        flush = np.all(np.abs(triangles @ normal + offset) < _COPLANAR, axis=1) & (
            hull.equations[:, :3] @ normal > 0.99
        )
        members = flush & left
        rings.append(_ordered(points[np.unique(hull.simplices[members])], normal))
        left &= ~members
    return Convex(rings)


def _ordered(corner: F64, normal: F64) -> F64:
    """The corners of a convex face in the order round its middle."""
    rel = corner - corner.mean(0)
    u = rel[0] / np.linalg.norm(rel[0])
    return corner[np.argsort(np.arctan2(rel @ np.cross(normal, u), rel @ u))]


def _normal(ring: F64) -> F64:
    n = np.cross(ring[1:-1] - ring[0], ring[2:] - ring[0]).sum(0)
    return n / np.linalg.norm(n)


def _open_edges(index: int, part: Convex, parts: list[Convex], skin: float) -> list[F64]:
    """Stretches of the part's upward faces' borders beyond which no other part continues the ground."""
    others = [p for i, p in enumerate(parts) if i != index]
    found = []
    for ring, normal in zip(part.rings, part.normals, strict=True):
        if normal[2] < _UPWARD:
            continue
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            found += _stretches(a, b, normal, ring.mean(0), others, skin)
    return found


def _stretches(a: F64, b: F64, normal: F64, middle: F64, others: list[Convex], skin: float) -> list[F64]:
    length = np.linalg.norm(b - a)
    if length < 1e-6:
        return []
    along = (b - a) / length
    outward = np.cross(along, normal)
    outward *= np.sign(outward @ ((a + b) / 2 - middle))
    count = max(2, int(np.ceil(length / _STEP)) + 1)
    s = np.linspace(0, length, count)
    # A point just outside the face and just below it lies in whatever continues the foothold there.
    probe = a + np.outer(s, along) + skin * (outward - normal)
    filled = np.zeros(count, bool)
    for other in others:
        filled |= other.contains(probe, 0.0)
    out, start = [], None
    for i in range(count + 1):
        free = i < count and not filled[i]
        if free and start is None:
            start = i
        elif not free and start is not None:
            if i - 1 > start:
                out.append(np.array([a + s[start] * along, a + s[i - 1] * along]))
            start = None
    return out
