"""Comparison of sources of points: figures of one capture's scene by each of them."""

import numpy as np

from realsim.core.meshes import across, areas, sampled
from realsim.core.types import AlignedScene, Mode, Pointmaps, TerrainMesh

MODES = ("onnx", "onnx+depth", "rgbd")
SAMPLES = 20_000


def others(delivered: str) -> tuple[str, ...]:
    """The modes that are compared with the delivered one."""
    return tuple(m for m in MODES if m != delivered)


def figures(
    points: Pointmaps, aligned: AlignedScene, mesh: TerrainMesh, seconds: float, delivered: TerrainMesh | None = None
) -> Mode:
    """Figures of one mode; `delivered` is the surface that it is compared with."""
    assert aligned.metric is not None
    scale = aligned.metric.scale
    start, goal = aligned.platform("start"), aligned.platform("goal")
    far = None if start is None or goal is None else float(np.linalg.norm((goal.centroid - start.centroid)[:2]))
    low, high = scale.ci90
    residuals = [r.median_abs_m for r in mesh.residuals]
    return Mode(
        backend=points.backend,
        scale=scale.value,
        scale_ci90=(low / scale.value, high / scale.value),
        used=len(points),
        dropped=len(points.dropped),
        pose_sigma_m=points.pose_sigma_m,
        depth_to_mesh_m=float(np.median(residuals)) if residuals else None,
        seen_m2=float(areas(mesh.vertices, mesh.seen).sum()),
        start_to_goal_m=far,
        apart_m=None if delivered is None else _apart(mesh, delivered),
        seconds=seconds,
    )


def _apart(mesh: TerrainMesh, delivered: TerrainMesh) -> float:
    """Median distance of points on one seen surface from the plane of the nearest triangle of the other."""
    from scipy.spatial import cKDTree

    centres = delivered.vertices[delivered.seen].mean(1)
    normals = across(delivered.vertices, delivered.seen)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    points, _ = sampled(mesh.vertices, mesh.seen, SAMPLES, np.random.default_rng(0))
    _, near = cKDTree(centres).query(points)
    return float(np.median(np.abs(((points - centres[near]) * normals[near]).sum(1))))
