"""A LiDAR scan of a synthetic terrain: what a scanner on a tripod sees from four places, as one point cloud.

realsim synth --terrain boston --frames 10 --out synthetic
python examples/06_lidar_scan.py synthetic scan.ply
"""

import sys
from pathlib import Path

import numpy as np
import open3d as o3d

synthetic, out = Path(sys.argv[1]), Path(sys.argv[2])
mesh = o3d.t.io.read_triangle_mesh(str(synthetic / "truth" / "mesh.ply"))
surface = o3d.t.geometry.RaycastingScene()
surface.add_triangles(mesh)
low, high = mesh.vertex.positions.numpy().min(0), mesh.vertex.positions.numpy().max(0)
rng = np.random.default_rng(0)
azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1600), np.radians(np.linspace(-75, 0, 300)))
directions = np.stack(
    [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
).reshape(-1, 3)
points = []
for x in (0.1, 0.9):
    for y in (-1.1, 1.1):  # beside the terrain, on both sides
        place = np.array([low[0] + x * (high[0] - low[0]), y, high[2] + 1.3])
        rays = np.hstack([np.broadcast_to(place, directions.shape), directions]).astype(np.float32)
        distance = surface.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        hit = np.isfinite(distance) & (distance < 8)
        measured = distance[hit] + rng.normal(0, 0.003, hit.sum())  # 3 mm of noise along the ray
        points.append(place + measured[:, None] * directions[hit])
cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate(points)))
o3d.io.write_point_cloud(str(out), cloud)
print(f"{len(cloud.points)} points in {out}")
