"""Cut away what no camera measured: membranes, bulges behind silhouettes, veils in seen-through space."""

from collections.abc import Sequence

import numpy as np

from realsim.core.meshes import vertex_normals
from realsim.meshing.fuse import Points
from realsim.meshing.surface import Surface
from realsim.meshing.visibility import DepthMap, seen_through, votes

REACH = 1.5
"""Cells from the nearest fused point beyond which a surface is a guess."""


def keep_measured(
    surface: Surface, points: Points, resolution: float, maps: Sequence[DepthMap] = (), sigma: float = 0.0
) -> Surface:
    """The triangles whose corners all have a fused point within reach that faces the same way (within 60 degrees), and
    of which none lies in space that the cameras of `maps` looked through. Corners close to a fused point are safe."""
    from scipy.spatial import cKDTree

    corners, triangles = surface.vertices, surface.triangles
    distance, near = cKDTree(points.points).query(corners, k=4, workers=2)
    agree = np.einsum("vki,vi->vk", points.normals[near], vertex_normals(corners, triangles)) > 0.5
    ok = ((distance < REACH * resolution) & agree).any(1) | (distance[:, 0] < 0.5 * resolution)
    keep = ok[triangles].all(1)
    if len(maps):
        doubtful = np.zeros(len(corners), bool)
        doubtful[triangles[keep]] = True
        doubtful &= distance[:, 0] > 0.6 * resolution
        ok[doubtful] = ~seen_through(*votes(corners[doubtful], maps, sigma, resolution))
        keep &= ok[triangles].all(1)
    return surface.where(keep)
