"""Comparison of sources of points: figures of one capture's scene by each of them."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F64, AlignedScene, Mode, Pointmaps, TerrainMesh

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
        seen_m2=float(_areas(mesh).sum()),
        start_to_goal_m=far,
        apart_m=None if delivered is None else _apart(mesh, delivered),
        seconds=seconds,
    )


def _areas(mesh: TerrainMesh) -> F64:
    t = mesh.vertices[mesh.seen]
    return np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1) / 2


def _sampled(mesh: TerrainMesh) -> F64:
    """(SAMPLES, 3) points spread evenly over the seen surface."""
    area = _areas(mesh)
    rng = np.random.default_rng(0)
    t = mesh.vertices[mesh.seen[rng.choice(len(area), SAMPLES, p=area / area.sum())]]
    u = rng.random((2, SAMPLES, 1))
    u = np.where(u.sum(0) > 1, 1 - u, u)
    return t[:, 0] + u[0] * (t[:, 1] - t[:, 0]) + u[1] * (t[:, 2] - t[:, 0])


def _apart(mesh: TerrainMesh, delivered: TerrainMesh) -> float:
    """Median distance of points on one seen surface from the plane of the nearest triangle of the other."""
    from scipy.spatial import cKDTree

    target = delivered.vertices[delivered.seen]
    centres = target.mean(1)
    normals = np.cross(target[:, 1] - target[:, 0], target[:, 2] - target[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    points = _sampled(mesh)
    _, near = cKDTree(centres).query(points)
    return float(np.median(np.abs(((points - centres[near]) * normals[near]).sum(1))))
