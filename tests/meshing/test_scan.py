"""Finished scans: cropped, welded, oriented meshes; clouds with and without normals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.errors import MeshError
from realsim.core.geometry import exp_so3, invert_T, make_T, transform
from realsim.core.types import Scan
from realsim.meshing import MeshConfig, build
from realsim.meshing.scan import outward

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


def faces(half: tuple[float, float], bottom: float, top: float, spacing: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Points on the four upright faces of a block about the z axis, and their normals out of it."""
    points, normals = [], []
    for axis in (0, 1):
        along = np.arange(-half[1 - axis], half[1 - axis], spacing) + spacing / 2
        t, z = (a.ravel() for a in np.meshgrid(along, np.arange(bottom, top, spacing) + spacing / 2))
        for sign in (-1.0, 1.0):
            one, normal = np.zeros((len(t), 3)), np.zeros(3)
            one[:, axis], one[:, 1 - axis], one[:, 2], normal[axis] = sign * half[axis], t, z, sign
            points.append(one)
            normals.append(np.broadcast_to(normal, one.shape))
    return np.concatenate(points), np.concatenate(normals)


def level(half: tuple[float, float], z: float, spacing: float = 0.02) -> np.ndarray:
    x, y = np.meshgrid(*(np.arange(-h, h, spacing) + spacing / 2 for h in half))
    return np.c_[x.ravel(), y.ravel(), np.full(x.size, z)]


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 0.5), st.floats(0.1, 0.5), st.floats(0.05, 1.0), st.floats(0, 6.28), st.integers(0, 100))
def test_side_faces_of_a_block_face_out_however_they_were_guessed(
    x: float, y: float, high: float, turn: float, seed: int
) -> None:
    floor, top = level((1, 1), 0.0), level((x, y), high)
    floor = floor[(np.abs(floor[:, :2]) > [x, y]).any(1)]
    side, out = faces((x, y), 0.0, high)
    points = np.concatenate([floor, top, side])
    normals = np.concatenate([np.tile([0, 0, 1.0], (len(floor) + len(top), 1)), out]) @ exp_so3([0, 0, turn]).T
    guess = np.random.default_rng(seed).choice([-1.0, 1.0], (len(points), 1))
    found = outward(points @ exp_so3([0, 0, turn]).T, guess * normals, 0.07)
    told = points[:, 2] > 0.07 / 4  # lower ones have no ground below them
    assert (found == normals)[told | (normals[:, 2] > 0.5)].all()


def test_walls_of_a_room_face_in_below_its_ceiling() -> None:
    half = (1.0, 0.8)
    flat, (wall, out) = [level(half, 0.0), level(half, 2.4)], faces(half, 0.0, 2.4)
    points = np.concatenate([*flat, wall])
    normals = np.concatenate([np.tile([0, 0, 1.0], (len(points) - len(wall), 1)), out])
    turned = (outward(points, normals, 0.07)[-len(wall) :] == -out).all(1)
    assert turned[wall[:, 2] > 0.07 / 4].all()


def test_nothing_level_tells_nothing() -> None:
    wall, out = faces((0.3, 0.3), 0.0, 0.5)
    assert (outward(wall, out, 0.07) == out).all()
    floor = level((0.5, 0.5), 0.0)
    assert (outward(floor, np.tile([0, 0, -1.0], (len(floor), 1)), 0.07) == [0, 0, 1]).all()


def test_side_faces_of_a_cloud_are_seen_from_outside() -> None:
    mesh = build(aligned(bounds=BOUNDS, scan=Scan(SOURCE, "test", cloud())), MeshConfig(close=False))
    corners = mesh.vertices[mesh.seen]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(1)
    side = (np.abs(normal[:, 2]) < 0.3 * np.linalg.norm(normal, axis=1)) & (np.abs(middle[:, 2] - 0.15) < 0.1)
    area = np.linalg.norm(normal[side], axis=1)
    out = (normal[side, :2] * middle[side, :2] / [0.25, 0.2]).sum(1) > 0
    assert area[out].sum() > 0.99 * area.sum()
    assert area.sum() / 2 == pytest.approx(0.2 * 1.8, rel=0.1)  # 20 cm of the height of a rim of 1.8 m
