"""Touching a terrain: in MuJoCo through its contacts, and exactly through distances to the reference mesh.

MuJoCo's rays hit a mesh geom's own triangles while its contacts use the convex hull, so rays call a hull perfect.
Whatever is measured here is therefore what a contact reports.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across
from realsim.core.types import F64
from realsim.export.contact.base import ContactModel
from realsim.export.contact.rays import Rays
from realsim.export.mjcf import contact_elements

MARGIN = 0.03  # metres within which MuJoCo is asked to report distances
BALL_RADIUS = 0.01
CEILING = 1.8  # metres above the ground: what faces down up there is not stepped on


@dataclass(frozen=True)
class Probe:
    """A rigid set of capsules (balls where both ends coincide), all of one radius."""

    ends: F64
    """(C, 2, 3) axis end points in the probe's frame, metres."""
    radius: float

    def points(self, spacing: float = 0.004) -> F64:
        """(M, 3) points on the axes, at most `spacing` apart: balls on them stand for the capsules."""
        rows = []
        for a, b in self.ends:
            steps = max(int(np.ceil(np.linalg.norm(b - a) / spacing)), 0) + 1
            rows.append(a + np.linspace(0, 1, steps)[:, None] * (b - a))
        return np.concatenate(rows)


BALL = Probe(np.zeros((1, 2, 3)), BALL_RADIUS)


def spec_of(contact: ContactModel) -> Any:
    """An `MjSpec` that holds a representation's geoms and nothing else."""
    import mujoco

    return mujoco.MjSpec.from_string(
        contact_elements(contact), assets={a.file: a.data for a in contact.assets if a.file}
    )


class SimTouch:
    """Clearance of probes from the colliding geoms of a specification's world.

    Args:
        spec: `MjSpec` of the terrain; it is copied, and bodies other than the world (robots) are taken out.
        probe: what touches.
        batch: probes that are in the model at once.
    """

    def __init__(self, spec: Any, probe: Probe, batch: int = 512) -> None:
        import mujoco

        self._mj = mujoco
        self.spec = terrain_only(spec)
        """`MjSpec` of what is touched, alone."""
        spec = self.spec.copy()
        spec.memory = 256 * 2**20
        # Probes have no affinity: they touch the terrain and never each other.
        common = {"size": [probe.radius, 0, 0], "mass": 1e-3, "contype": 1, "conaffinity": 0, "margin": MARGIN}
        geoms: list[dict[str, Any]] = []
        for a, b in probe.ends:
            ball = bool(np.allclose(a, b))
            shape = {"pos": a} if ball else {"fromto": np.concatenate([a, b])}
            kind = mujoco.mjtGeom.mjGEOM_SPHERE if ball else mujoco.mjtGeom.mjGEOM_CAPSULE
            geoms.append({"type": kind, **shape, **common})
        for _ in range(batch):
            body = spec.worldbody.add_body()
            body.add_joint()  # a hinge that stays where it is: free joints take the compiler three times as long
            for geom in geoms:
                body.add_geom(**geom)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.batch = batch
        self._owner = self.model.geom_bodyid - 1  # the world is body 0

    @cached_property
    def triangles(self) -> tuple[F64, NDArray[np.int32]]:
        """(V, 3) and (K, 3) of what the world's geoms collide as: hulls of meshes, and a floor of 100 m.

        Raises:
            ExportError: a geom is neither plane, box, height field nor mesh.
        """
        from realsim.export.formats.scene import collision_triangles

        model = self.spec.compile()
        data = self._mj.MjData(model)
        self._mj.mj_forward(model, data)
        return collision_triangles(model, data)

    def clearance(self, positions: F64, quats: F64) -> F64:
        """(N,) distance of each probe at (N, 3), (N, 4) from the nearest geom, negative inside, at most MARGIN."""
        out = np.full(len(positions), MARGIN)
        for start in range(0, len(positions), self.batch):
            part = slice(start, start + self.batch)
            self._collide(positions[part], quats[part])
            np.minimum.at(out[part], self._probe_of_contact(), self.data.contact.dist)
        return out

    def normals(self, positions: F64, quats: F64) -> F64:
        """(N, 3) outward normal of the nearest contact of each probe; NaN where there is none."""
        out = np.full((len(positions), 3), np.nan)
        for start in range(0, len(positions), self.batch):
            part = slice(start, start + self.batch)
            self._collide(positions[part], quats[part])
            contact = self.data.contact
            order = np.argsort(-contact.dist, kind="stable")  # the nearest is written last
            sign = np.where(self._owner[contact.geom1] < 0, 1.0, -1.0)  # normals point from geom1 to geom2
            out[part][self._probe_of_contact()[order]] = (sign[:, None] * contact.frame[:, :3])[order]
        return out

    def _collide(self, positions: F64, quats: F64) -> None:
        model, count = self.model, len(positions)
        model.body_pos[1 : count + 1], model.body_quat[1 : count + 1] = positions, quats
        # What is not asked for is left out: waiting far away, each of the hundreds would be compared with all others.
        model.body_contype[1:] = np.arange(self.batch) < count
        self._mj.mj_kinematics(model, self.data)
        self._mj.mj_collision(model, self.data)

    def _probe_of_contact(self) -> NDArray[np.int64]:
        return np.maximum(self._owner[self.data.contact.geom1], self._owner[self.data.contact.geom2])


def terrain_only(spec: Any) -> Any:
    """A copy with the world's own geoms only, all colliding ones with anything."""
    spec = spec.copy()
    for key in list(spec.keys):
        spec.delete(key)
    for body in [b for b in spec.bodies if b.parent == spec.worldbody]:
        spec.delete(body)
    for geom in spec.worldbody.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = 1, 1
    return spec


class Reference:
    """The exact surface: distances, and what lies above a point."""

    def __init__(self, vertices: F64, triangles: NDArray[np.int32], invented: NDArray[np.bool_] | None = None) -> None:
        self.vertices, self.triangles = vertices, triangles
        self.invented = np.zeros(len(triangles), bool) if invented is None else invented
        """(K,) triangles that were not measured."""
        self.up = across(vertices, triangles)[:, 2] > 0
        self._rays = Rays(vertices, triangles)

    @cached_property
    def seen_only(self) -> Reference:
        """The measured part of it."""
        if not self.invented.any():
            return self
        return Reference(self.vertices, np.ascontiguousarray(self.triangles[~self.invented]))

    def cast(self, origins: F64, ways: F64) -> tuple[F64, F64, F64]:
        """First hits of rays (N, 3), (N, 3) unit: ((N,) metres, inf for none; (N,) cosine of the way and the normal of
        what was hit, negative at its front; (N, 3) that normal)."""
        t, triangle = self._rays.cast(origins, ways)
        normal = across(self.vertices, self.triangles[np.maximum(triangle, 0)])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
        return t, (normal * ways).sum(1), normal

    def start_above(self, xy: F64, ground_z: float) -> F64:
        """(M,) z from which a thing falls onto the terrain at x y (M, 2): inf where all is open above, else just below
        the lowest face over CEILING above the ground that faces down with a face that faces up under it."""
        start = np.full(len(xy), np.inf)
        left = np.arange(len(xy))
        down = np.array([0.0, 0.0, -1.0])
        while len(left):
            top = np.minimum(start[left], float(self.vertices[:, 2].max()) + 1.0)
            t, cosine, _ = self.cast(np.column_stack([xy[left], top]), np.broadcast_to(down, (len(left), 3)))
            z = top - t
            ceiling = np.isfinite(t) & (cosine > 0) & (z > ground_z + CEILING)
            left = left[ceiling]
            start[left] = z[ceiling] - 1e-4
        return start

    def distance(self, points: F64) -> F64:
        """(...) unsigned distance of points (..., 3) from the surface."""
        return self._rays.distance(points)

    def normals(self, points: F64) -> F64:
        """(M, 3) unit direction from the nearest surface point to each of the points."""
        away = points - self._rays.nearest(points)
        return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)

    def top(self, xy: F64, below: F64 | None = None) -> F64:
        """(M,) z of the highest surface at x y (M, 2), of those `below` z (M,); NaN where there is none."""
        above = np.full(len(xy), float(self.vertices[:, 2].max()) + 1.0)
        above = above if below is None else np.minimum(below, above)
        start = np.column_stack([xy, above])
        t, _ = self._rays.cast(start, np.broadcast_to([0.0, 0.0, -1.0], start.shape))
        return np.where(np.isfinite(t), above - t, np.nan)

    def buried(self, points: F64) -> NDArray[np.bool_]:
        """(M,) whether a point is inside or below a solid.

        So it is if the first surface straight above faces up, or if more of those above face up than down: where solids
        overlap, the underside of one lies inside the other.
        """
        up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        _, triangle = self._rays.cast(points, up)
        inside = (triangle >= 0) & self.up[triangle]
        below = np.flatnonzero((triangle >= 0) & ~inside)
        ray, _, triangle = self._rays.crossings(points[below], up[below])
        ways_out = np.bincount(ray, weights=np.where(self.up[triangle], 1, -1), minlength=len(below))
        inside[below] = ways_out > 0
        return inside

    def depth(self, points: F64) -> F64:
        """(M,) metres to the surface upwards and to the sides, whichever is nearest; of a point in a solid, how far
        it got in (the floor beneath does not count). Points of no solid get what is in their way."""
        angle = np.arange(8) * np.pi / 4
        ways = np.vstack([np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)]), [[0, 0, 1.0]]])
        t, _ = self._rays.cast(np.repeat(points, len(ways), axis=0), np.tile(ways, (len(points), 1)))
        return t.reshape(len(points), len(ways)).min(1)

    def clearance(self, probe: Probe, positions: F64, quats: F64) -> F64:
        """(N,) distance of the probe's surface at poses (N, 3), (N, 4) from the reference."""
        from scipy.spatial.transform import Rotation

        rotations = Rotation.from_quat(quats, scalar_first=True).as_matrix()
        offsets = np.einsum("nij,mj->nmi", rotations, probe.points())
        return self.distance(positions[:, None, :] + offsets).min(1) - probe.radius


Clearance = Callable[[F64, F64], F64]


def first_touch(clearance: Clearance, start: F64, quats: F64, direction: F64, length: float) -> F64:
    """(N,) distance along `direction` at which each probe first touches.

    Conservative advancement: as far as the clearance allows, but at least `BALL_RADIUS` a step, so that gliding along
    a wall comes to an end (what a ball of that radius can step over lies 1.3 mm deep in its path); then bisection to
    0.02 mm.

    Args:
        clearance: (positions (M, 3), quaternions (M, 4)) -> (M,) metres.
        start: (N, 3). quats: (N, 4) w x y z. direction: (N, 3) unit.

    Returns:
        Metres; inf where nothing is touched within `length`, NaN where the probe touches already at the start.
    """
    count = len(start)
    free, touching = np.zeros(count), np.full(count, np.inf)
    blocked = clearance(start, quats) <= 0

    def gap(index: NDArray[np.int64], t: F64) -> F64:
        return clearance(start[index] + t[:, None] * direction[index], quats[index])

    active = np.flatnonzero(~blocked)
    at = np.zeros(count)
    while len(active):
        now = gap(active, at[active])
        hit = now <= 0
        touching[active[hit]] = at[active[hit]]
        active, now = active[~hit], now[~hit]
        free[active] = at[active]
        at[active] += np.maximum(now, BALL_RADIUS)
        active = active[free[active] < length]
    found = np.flatnonzero(np.isfinite(touching))
    for _ in range(10):
        middle = (free[found] + touching[found]) / 2
        inside = gap(found, middle) <= 0
        touching[found] = np.where(inside, middle, touching[found])
        free[found] = np.where(inside, free[found], middle)
    return np.where(blocked, np.nan, np.where(np.isfinite(touching), free, np.inf))
