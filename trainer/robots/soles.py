"""Where a foot meets the ground."""

from typing import Any

import mujoco
import numpy as np

from realsim.core.geometry import quat_to_R
from realsim.core.meshes import mesh_of
from realsim.core.types import F64

GRID = (9, 4)
"""Points along and across a sole. Even spacing matters: with points only under the ends of G1's capsules, an edge below
the arch of the foot was invisible, and sliding off a small stake paid."""
FLAT_M = 0.01
"""What lies at most this much above the lowest point of a foot is its sole."""
POINT_M = 0.02
"""A sole that is shorter in both directions is a point."""


def sole_points(model: Any, foot: str) -> F64:
    """(P, 3) points on the sole of a foot in the foot body's frame, metres.

    An even grid over the rectangle around the lowest points of the foot's collision geoms, at their mean height; one
    point for a foot that is a sphere or as small as one.

    Args:
        model: compiled.
        foot: name of the body; its z axis points up when the foot is level.
    """
    body = model.body(foot).id
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and collides(model, g)]
    points = np.vstack([outline(model, g) for g in geoms])
    lowest = points[points[:, 2] < points[:, 2].min() + FLAT_M]
    (x0, y0, _), (x1, y1, _) = lowest.min(0), lowest.max(0)
    if max(x1 - x0, y1 - y0) < POINT_M:
        return lowest[[np.argmin(lowest[:, 2])]]
    x, y = np.meshgrid(np.linspace(x0, x1, GRID[0]), np.linspace(y0, y1, GRID[1]), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, lowest[:, 2].mean())], -1)


def collides(model: Any, geom: int) -> bool:
    """Whether a geom of a compiled model is more than drawn."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def outline(model: Any, geom: int, down: F64 | None = None) -> F64:
    """(Q, 3) points of a geom's surface in its body's frame that are its lowest or beside them, metres.

    Two of a capsule (below its ends), one of a sphere or ellipsoid, all corners or vertices of anything else.

    Args:
        down: (3,) where down is in the body's frame; -z if not given.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    R, centre = quat_to_R(model.geom_quat[geom]), model.geom_pos[geom]
    below = np.array([0.0, 0.0, -1.0]) if down is None else down
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_SPHERE:
        return (centre + size[0] * below)[None]
    if kind == types.mjGEOM_CAPSULE:
        return centre + np.outer([-1.0, 1.0], R[:, 2] * size[1]) + size[0] * below
    if kind == types.mjGEOM_ELLIPSOID:
        local = size**2 * (R.T @ below)
        return (centre + R @ (local / np.linalg.norm(local / size)))[None]
    if kind == types.mjGEOM_MESH:
        return centre + mesh_of(model, model.geom_dataid[geom])[0] @ R.T
    if kind == types.mjGEOM_CYLINDER:
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        rim = np.stack([size[0] * np.cos(turn), size[0] * np.sin(turn), np.full(12, size[1])], -1)
        return centre + np.vstack([rim, rim * [1, 1, -1]]) @ R.T
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return centre + (corners * size) @ R.T
