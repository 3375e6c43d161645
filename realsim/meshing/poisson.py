"""Screened Poisson reconstruction of fused points, cut back to what was measured (Kazhdan and Hoppe 2013)."""

from __future__ import annotations

import numpy as np

from realsim.core.errors import MeshError
from realsim.meshing.fuse import Points
from realsim.meshing.surface import Surface

POINT_WEIGHT = 8.0
"""How strongly the surface is held to the points; the paper's default is 4. Points here are already denoised."""
MAX_DEPTH = 11


def reconstruct(points: Points, resolution: float) -> Surface:
    """The closed-where-it-can surface through oriented points, cells of `resolution` metres, no trimming.

    One thread: with more, the solver's sums run in another order each time and the bytes differ.
    """
    import open3d as o3d

    if len(points) < 100:
        raise MeshError(
            "too few points for a surface", expected="at least 100", found=str(len(points)), hint="check the bounds"
        )
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.points))
    cloud.normals = o3d.utility.Vector3dVector(points.normals)
    extent = float(np.ptp(points.points, axis=0).max())
    depth = int(np.ceil(np.log2(1.05 * extent / resolution)))
    if not 3 <= depth <= MAX_DEPTH:
        raise MeshError(
            "the resolution does not suit the size of the scene",
            expected=f"{1.05 * extent / 2**MAX_DEPTH:.4f} to {extent / 8:.3f} m for a scene of {extent:.2f} m",
            found=f"{resolution} m",
            hint="set --resolution",
        )
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=resolution * 2**depth / extent, n_threads=1, point_weight=POINT_WEIGHT
        )
    return Surface(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32))
