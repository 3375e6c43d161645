"""Finished scans: cropped, welded, oriented meshes; clouds with and without normals."""

from __future__ import annotations

import numpy as np
import pytest

from realsim.errors import MeshError
from realsim.geometry import exp_so3, invert_T, make_T, transform
from realsim.meshing import MeshConfig, build
from realsim.types import Scan

from .scenes import SOURCE, Box, aligned, distance

BOUNDS = ((-0.8, -0.8, -0.1), (0.8, 0.8, 0.8))
BLOCK = Box((-0.25, -0.2, 0.0), (0.25, 0.2, 0.3))


def cloud(n: int = 60_000, seed: int = 0, noise: float = 0.002) -> np.ndarray:
    """Points on a floor and a block's top and sides."""
    rng = np.random.default_rng(seed)
    floor = np.c_[rng.uniform(-1, 1, (n, 2)), np.zeros(n)]
    floor = floor[(np.abs(floor[:, :2]) > [0.25, 0.2]).any(1)]
    top = np.c_[rng.uniform([-0.25, -0.2], [0.25, 0.2], (n // 8, 2)), np.full(n // 8, 0.3)]
    sides = rng.uniform([-0.25, -0.2, 0], [0.25, 0.2, 0.3], (n // 6, 3))
    k = rng.integers(0, 4, len(sides))
    sides[k == 0, 0], sides[k == 1, 0], sides[k == 2, 1], sides[k == 3, 1] = -0.25, 0.25, -0.2, 0.2
    points = np.concatenate([floor, top, sides])
    return points + rng.normal(0, noise, points.shape)


def test_a_cloud_becomes_a_surface() -> None:
    T = make_T(exp_so3([0.3, 1.0, -0.5]), [1.0, 2.0, 3.0])
    points = cloud()
    scan = Scan(SOURCE, "test", transform(invert_T(T), points), colors=np.full((len(points), 3), 77, np.uint8))
    mesh = build(aligned(bounds=BOUNDS, T_sim_world=T, scan=scan), MeshConfig(close=False))
    d = distance([BLOCK], mesh.vertices[np.unique(mesh.seen)])
    assert np.median(d) < 0.002
    assert (d < 0.02).mean() > 0.97
    assert mesh.noise_m == pytest.approx(0.002, rel=0.5)
    assert mesh.colors is not None
    assert (mesh.colors == 77).all()
    assert mesh.residuals == ()


def test_a_mesh_is_cropped_welded_and_turned_up() -> None:
    # a soup of separate triangles, wound downward, wider than the bounds
    x = np.linspace(-2, 2, 81)
    X, Y = np.meshgrid(x[:-1], x[:-1], indexing="ij")
    a = np.stack([X, Y, 0 * X], -1).reshape(-1, 3)
    e = 0.05
    corner = [a + np.array(shift) for shift in ([0, 0, 0], [e, e, 0], [e, 0, 0], [0, e, 0])]
    lower, upper = np.stack([corner[k] for k in (0, 1, 2)], 1), np.stack([corner[k] for k in (0, 3, 1)], 1)
    soup = np.concatenate([lower, upper]).reshape(-1, 3)
    scan = Scan(SOURCE, "test", soup, np.arange(len(soup)).reshape(-1, 3).astype(np.int32))
    mesh = build(aligned(bounds=BOUNDS, scan=scan), MeshConfig(close=False))
    assert mesh.method == "scan mesh"
    assert mesh.quality.components == 1
    assert mesh.quality.manifold
    n = np.cross(*(mesh.vertices[mesh.triangles[:, k]] - mesh.vertices[mesh.triangles[:, 0]] for k in (1, 2)))
    assert (n[:, 2] > 0).all()
    assert np.abs(mesh.vertices[:, :2]).max() < 0.9
    assert len(mesh.vertices) < 1.2 * len(mesh.triangles) / 2 + 200


def test_a_scan_outside_the_bounds_is_refused() -> None:
    scan = Scan(SOURCE, "test", cloud(2000) + 10.0)
    with pytest.raises(MeshError, match="too few points"):
        build(aligned(bounds=BOUNDS, scan=scan), MeshConfig())
