"""Truncated signed distance fusion (Curless and Levoy 1996) in Open3D's sparse voxel blocks: the plain alternative."""

from __future__ import annotations

import numpy as np

from realsim.core.geometry import invert_T, make_T
from realsim.core.progress import track
from realsim.core.types import AlignedScene
from realsim.meshing.surface import Surface
from realsim.meshing.views import pinhole

BLOCK = 16


def reconstruct(aligned: AlignedScene, resolution: float, min_weight: float = 3.0) -> Surface:
    """The zero surface of the fused distance inside the bounds, voxels of `resolution` metres.

    Args:
        min_weight: views that must have contributed to a voxel.
    """
    import open3d as o3d
    import open3d.core as o3c

    metric = aligned.metric
    assert metric is not None
    size = aligned.bounds[1] - aligned.bounds[0]
    blocks = int(4 * np.prod(np.ceil(size / (BLOCK * resolution)) + 1)) + 1000
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"),
        (o3c.float32, o3c.float32),
        (o3c.SizeVector([1]), o3c.SizeVector([1])),
        resolution,
        BLOCK,
        blocks,
    )
    far = float(np.linalg.norm(size) + 10)
    for i in track(range(len(metric)), "fusing"):
        view = metric.load(i)
        T_sim_camera = aligned.T_sim_camera(i)
        P = view.points.reshape(-1, 3).astype(np.float64) @ T_sim_camera[:3, :3].T + T_sim_camera[:3, 3]
        inside = ((aligned.bounds[0] < P) & (aligned.bounds[1] > P)).all(1).reshape(view.mask.shape)
        z = np.where(view.mask & inside, view.points[..., 2], 0).astype(np.float32)
        if not (z > 0).any():
            continue
        fx, fy, cx, cy = pinhole(view)
        depth = o3d.t.geometry.Image(np.ascontiguousarray(z))
        K = o3c.Tensor.from_numpy(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
        # Open3D integrates in the world that the extrinsic leads from; ours is the simulation frame.
        E = o3c.Tensor.from_numpy(invert_T(make_T(T_sim_camera[:3, :3], T_sim_camera[:3, 3])))
        touched = grid.compute_unique_block_coordinates(depth, K, E, 1.0, far)
        grid.integrate(touched, depth, K, E, 1.0, far)
    mesh = grid.extract_triangle_mesh(weight_threshold=min(min_weight, len(metric))).to_legacy()
    return Surface(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32).reshape(-1, 3))
