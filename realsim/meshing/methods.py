"""Surface methods: (aligned, evidence) -> measured surface. Screened Poisson (Kazhdan and Hoppe 2013), cut back to what
was measured; signed distance fusion of the depth in voxel blocks is the plain alternative."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from realsim.core.errors import MeshError
from realsim.core.geometry import invert_T, make_T
from realsim.core.progress import track
from realsim.core.types import AlignedScene
from realsim.meshing.evidence import Evidence
from realsim.meshing.fuse import Points
from realsim.meshing.surface import Surface
from realsim.meshing.trim import keep_measured
from realsim.meshing.views import camera_of

POINT_WEIGHT = 8.0
"""How strongly the surface is held to the points; the paper's default is 4. Points here are already denoised."""
MAX_DEPTH = 11
BLOCK = 16


def poisson(aligned: AlignedScene, evidence: Evidence) -> Surface:
    """Screened Poisson of the fused points, trimmed to what was measured."""
    surface = screened_poisson(evidence.points, evidence.resolution)
    return _trimmed(surface, evidence)


def tsdf(aligned: AlignedScene, evidence: Evidence) -> Surface:
    """Signed distance fusion of the depth, trimmed to what was measured."""
    from realsim.core.open3d import o3d

    o3c = o3d.core

    metric = aligned.metric
    assert metric is not None
    size = aligned.bounds[1] - aligned.bounds[0]
    blocks = int(4 * np.prod(np.ceil(size / (BLOCK * evidence.resolution)) + 1)) + 1000
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"),
        (o3c.float32, o3c.float32),
        (o3c.SizeVector([1]), o3c.SizeVector([1])),
        evidence.resolution,
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
        depth = o3d.t.geometry.Image(np.ascontiguousarray(z))
        K = o3c.Tensor.from_numpy(camera_of(metric.frames[i], view).K)
        # Open3D integrates in the world that the extrinsic leads from; ours is the simulation frame.
        E = o3c.Tensor.from_numpy(invert_T(make_T(T_sim_camera[:3, :3], T_sim_camera[:3, 3])))
        touched = grid.compute_unique_block_coordinates(depth, K, E, 1.0, far)
        grid.integrate(touched, depth, K, E, 1.0, far)
    mesh = grid.extract_triangle_mesh(weight_threshold=min(3.0, len(metric))).to_legacy()
    surface = Surface(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32).reshape(-1, 3))
    return _trimmed(surface, evidence)


def _trimmed(surface: Surface, evidence: Evidence) -> Surface:
    return keep_measured(surface, evidence.points, evidence.resolution, evidence.maps, evidence.sigma)


def screened_poisson(points: Points, resolution: float) -> Surface:
    """The closed-where-it-can surface through oriented points, cells of `resolution` metres, no trimming.

    One thread: with more, the solver's sums run in another order each time and the bytes differ.
    """
    from realsim.core.open3d import o3d

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
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error), without_solver_warnings():
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=resolution * 2**depth / extent, n_threads=1, point_weight=POINT_WEIGHT
        )
    return Surface(np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int32))


WITHOUT_WARNINGS = """
import sys
warning = False
for line in sys.stdin.buffer:
    warning = line.startswith(b"[WARNING] ") or (warning and line.startswith(b" " * 10))
    if not warning:
        sys.stderr.buffer.write(line)
"""
"""A program that hands text on without PoissonRecon's warnings: a line with a place in its code, and indented ones."""


@contextmanager
def without_solver_warnings() -> Iterator[None]:
    """Keeps the warnings that PoissonRecon writes to the error stream, past Open3D's verbosity, out of the terminal.

    A process of its own reads the stream: the solver holds Python's lock, and may end this process with a last word.
    """
    sys.stderr.flush()
    stream = os.dup(2)
    reader = subprocess.Popen([sys.executable, "-ISc", WITHOUT_WARNINGS], stdin=subprocess.PIPE)
    assert reader.stdin is not None
    os.dup2(reader.stdin.fileno(), 2)
    reader.stdin.close()
    try:
        yield
    finally:
        sys.stderr.flush()
        os.dup2(stream, 2)
        os.close(stream)
        with suppress(subprocess.TimeoutExpired):  # a process that began meanwhile keeps the stream open
            reader.wait(5)
