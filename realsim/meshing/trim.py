"""Cut away what no camera measured: membranes, bulges behind silhouettes, veils in seen-through space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from realsim.core.meshes import vertex_normals
from realsim.core.types import Bool
from realsim.meshing.fuse import Points
from realsim.meshing.surface import Surface
from realsim.meshing.visibility import DepthMap, seen_through, votes

REACH = 1.5
"""Cells from the nearest fused point beyond which a surface is a guess."""


def supported(surface: Surface, points: Points, resolution: float) -> Bool:
    """(K,) triangles whose corners all have a fused point within reach that faces the same way (within 60 degrees)."""
    from scipy.spatial import cKDTree

    normal = vertex_normals(surface.vertices, surface.triangles)
    distance, near = cKDTree(points.points).query(surface.vertices, k=4, workers=2)
    reach = np.maximum(REACH * resolution, 0)
    agree = np.einsum("vki,vi->vk", points.normals[near], normal) > 0.5
    ok = ((distance < reach) & agree).any(1) | (distance[:, 0] < 0.5 * resolution)
    return np.asarray(ok[surface.triangles].all(1), bool)


def not_seen_through(
    surface: Surface, points: Points, resolution: float, maps: Sequence[DepthMap], sigma: float
) -> Bool:
    """(K,) triangles that do not lie in space that cameras looked through. Those close to a fused point are safe."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points.points).query(surface.vertices, workers=2)
    doubtful = distance > 0.6 * resolution
    ok = np.ones(len(surface.vertices), bool)
    ok[doubtful] = ~seen_through(*votes(surface.vertices[doubtful], maps, sigma, resolution))
    return np.asarray(ok[surface.triangles].all(1), bool)
