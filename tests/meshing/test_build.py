"""The surface of analytic scenes: accurate, sharp, open where it is open, the same every time."""

import os
from dataclasses import replace

import numpy as np
import pytest

from realsim.core.errors import MeshError, UnknownNameError
from realsim.core.geometry import exp_so3, make_T
from realsim.core.rays import raycasting_scene
from realsim.core.types import AlignedScene, TerrainMesh
from realsim.meshing import METHODS, MeshConfig, build, solid
from realsim.meshing.methods import without_solver_warnings
from realsim.meshing.quality import check
from realsim.meshing.surface import Surface

from .scenes import Ball, Box, distance, one_side, ring, scene

BLOCK = Box((-0.25, -0.2, 0.0), (0.25, 0.2, 0.3))
CONFIG = MeshConfig(resolution=0.015, residual_views=2)
COARSE = replace(CONFIG, resolution=0.025)


def seen(mesh: TerrainMesh) -> Surface:
    return Surface(mesh.vertices, mesh.triangles).where(~mesh.invented)


@pytest.fixture(scope="module")
def block() -> tuple[AlignedScene, TerrainMesh]:
    aligned = scene([BLOCK], ring(), noise=0.0015)
    return aligned, build(aligned, CONFIG)


def test_noise_is_averaged_away(block: tuple[AlignedScene, TerrainMesh]) -> None:
    surface = seen(block[1])
    d = distance([BLOCK], surface.sample(20_000, 0))
    assert np.median(d) < 0.0015
    assert (d < 0.01).mean() > 0.98
    # The block is there: its top, not just the floor.
    top = surface.vertices[(np.abs(surface.vertices[:, :2]) < [0.2, 0.15]).all(1)]
    assert abs(np.median(top[:, 2]) - 0.3) < 0.001


def test_vertical_faces_stay_vertical(block: tuple[AlignedScene, TerrainMesh]) -> None:
    surface = seen(block[1])
    centre, cross = surface.centres(), surface.crosses()
    area = np.linalg.norm(cross, axis=1)
    normal = cross / area[:, None]
    wall = (np.abs(centre[:, 0] - 0.25) < 0.02) & (np.abs(centre[:, 1]) < 0.15) & (np.abs(centre[:, 2] - 0.15) < 0.1)
    assert area[wall].sum() / 2 > 0.9 * 0.3 * 0.2
    assert np.average(normal[wall, 0], weights=area[wall]) > 0.97
    tilt = np.degrees(np.arcsin(np.clip(np.average(normal[wall, 2], weights=area[wall]), -1, 1)))
    assert abs(tilt) < 2
    assert abs(np.average(centre[wall, 0], weights=area[wall]) - 0.25) < 0.002


def test_somebody_who_walks_by_is_left_out_and_said(block: tuple[AlignedScene, TerrainMesh]) -> None:
    assert block[1].warnings == ()
    path = [Box((x, 0.4, 0.0), (x + 0.2, 0.55, 0.7)) for x in np.linspace(-0.7, 0.5, 12)]
    mesh = build(scene([BLOCK], ring(), noise=0.0015, passing=path), COARSE)
    assert any("looked through" in w for w in mesh.warnings)
    surface = seen(mesh)
    lost = distance([BLOCK], surface.sample(20_000, 0)) > 0.03
    assert lost.mean() < 0.05


def test_somebody_who_shifts_from_foot_to_foot_is_said() -> None:
    path = [Box((x, 0.4, 0.0), (x + 0.15, 0.55, 0.5)) for x in 0.1 * np.sin(1.3 * np.arange(24))]
    mesh = build(scene([BLOCK], ring(24), noise=0.0015, passing=path), COARSE)
    assert any("looked through" in w for w in mesh.warnings)


def test_same_input_same_bytes(block: tuple[AlignedScene, TerrainMesh]) -> None:
    again = build(block[0], CONFIG)
    for name in ("vertices", "triangles", "invented", "colors"):
        assert getattr(again, name).tobytes() == getattr(block[1], name).tobytes(), name
    assert again.statistics == block[1].statistics


def test_colour_noise_and_residuals_are_reported(block: tuple[AlignedScene, TerrainMesh]) -> None:
    mesh = block[1]
    used = np.unique(mesh.seen)
    assert mesh.colors is not None
    assert (mesh.colors[used] == (200, 100, 50)).all()
    assert mesh.noise_m is not None
    assert 0 < mesh.noise_m < 0.01
    assert mesh.statistics["pixel_noise_1m_mm"] == pytest.approx(1.5, rel=0.15)
    assert len(mesh.residuals) == 2
    assert all(r.median_abs_m < 0.006 for r in mesh.residuals)
    assert mesh.residuals[0].image.shape == (30, 40)


def test_the_frame_of_the_capture_does_not_matter(block: tuple[AlignedScene, TerrainMesh]) -> None:
    T = make_T(exp_so3([0.4, -1.0, 2.0]), [3.0, -2.0, 1.0])
    turned = build(scene([BLOCK], ring(), noise=0.0015, T_sim_world=T), replace(CONFIG, close=False))
    assert np.median(seen(block[1]).distance(seen(turned).sample(5000, 0))) < 1e-4


@pytest.mark.parametrize("method", list(METHODS))
def test_methods_find_a_ball(method: str) -> None:
    ball = Ball((0.0, 0.0, 0.3), 0.3)
    mesh = build(scene([ball], ring(), noise=0.001), replace(CONFIG, method=method, resolution=0.02, close=False))
    assert mesh.method == method
    assert mesh.quality.manifold
    assert mesh.quality.degenerate == 0
    d = distance([ball], seen(mesh).sample(20_000, 0))
    assert np.median(d) < 0.25 * mesh.resolution
    assert (d < mesh.resolution).mean() > 0.97


def test_a_gap_that_was_seen_through_stays_open() -> None:
    beam = [
        Box((-0.6, -0.08, 0.2), (0.6, 0.08, 0.3)),
        Box((-0.6, -0.08, 0), (-0.5, 0.08, 0.2)),
        Box((0.5, -0.08, 0), (0.6, 0.08, 0.2)),
    ]
    aligned = scene(beam, one_side(12), noise=0.001)
    mesh = build(aligned, CONFIG)
    gap = mesh.vertices[mesh.triangles].mean(1)
    in_gap = (np.abs(gap[:, 0]) < 0.4) & (np.abs(gap[:, 1] + 0.06) < 0.03) & (gap[:, 2] > 0.03) & (gap[:, 2] < 0.12)
    assert not in_gap.any()
    # A ball can roll through below the near edge, and cannot fall through the beam.
    body = solid(mesh, aligned)
    inside = _inside(body, np.array([[0.0, -0.07, 0.08], [0.2, -0.07, 0.08], [0.0, -0.04, 0.26], [0.55, 0.0, 0.1]]))
    assert inside.tolist() == [False, False, True, True]


def test_far_sides_are_invented_and_said_so() -> None:
    aligned = scene([BLOCK], one_side(), noise=0.001)
    mesh = build(aligned, COARSE)
    centre = mesh.vertices[mesh.triangles].mean(1)
    back = (np.abs(centre[:, 0]) < 0.2) & (np.abs(centre[:, 1] - 0.2) < 0.04) & (np.abs(centre[:, 2] - 0.12) < 0.08)
    assert back.any()
    assert mesh.invented[back].all()
    front = (np.abs(centre[:, 0]) < 0.2) & (np.abs(centre[:, 1] + 0.2) < 0.01) & (np.abs(centre[:, 2] - 0.15) < 0.1)
    assert front.any()
    assert not mesh.invented[front].any()
    none = build(aligned, replace(COARSE, close=False))
    assert not none.invented.any()
    assert np.array_equal(none.seen, mesh.seen)


def test_solid_is_closed_and_has_the_right_volume(block: tuple[AlignedScene, TerrainMesh]) -> None:
    aligned, mesh = block
    body = solid(mesh, aligned)
    quality = check(body)
    assert quality.watertight
    assert quality.manifold
    assert quality.volume_m3 is not None
    size = body.vertices.max(0) - body.vertices.min(0)
    slab = size[0] * size[1] * -body.vertices[:, 2].min()
    assert quality.volume_m3 - slab == pytest.approx(0.5 * 0.4 * 0.3, rel=0.08)
    assert _inside(body, np.array([[0, 0, 0.27], [0, 0, 0.33], [0.24, 0.19, 0.15], [0.28, 0, 0.15]])).tolist() == [
        True, False, True, False,
    ]  # fmt: skip


def test_islands_are_removed() -> None:
    speck = Ball((0.5, 0.5, 0.5), 0.08)
    aligned = scene([BLOCK, speck], ring(16), noise=0.0005)
    config = replace(COARSE, close=False)
    assert (seen(build(aligned, replace(config, min_island=0.2))).vertices[:, 2] < 0.36).all()
    kept = build(aligned, replace(config, min_island=0.0))
    assert (seen(kept).vertices[:, 2] > 0.45).any()


def test_decimation_keeps_to_count_and_bound() -> None:
    aligned = scene([BLOCK], ring(), noise=0.001)
    few = build(aligned, replace(COARSE, close=False, max_triangles=4000, max_error=0.01))
    assert few.quality.triangles <= 4000
    assert 0 < few.statistics["decimation_error_mm"] <= 10
    strict = build(aligned, replace(COARSE, close=False, max_triangles=1000, max_error=0.0005))
    assert strict.quality.triangles > 1000
    assert strict.statistics["decimation_error_mm"] <= 0.5
    assert strict.statistics["kept_for_error_bound"]


def test_errors_say_what_to_do() -> None:
    aligned = scene([BLOCK], ring(3), noise=0.001)
    with pytest.raises(UnknownNameError, match="poisson"):
        build(aligned, MeshConfig(method="poison"))
    nowhere = replace(aligned, bounds=np.array([[5.0, 5, 5], [6, 6, 6]]))
    with pytest.raises(MeshError, match="bounds"):
        build(nowhere, CONFIG)
    with pytest.raises(ValueError, match="resolution"):
        MeshConfig(resolution=-1)


def _inside(surface: Surface, points: np.ndarray) -> np.ndarray:
    import open3d as o3d

    query = o3d.core.Tensor.from_numpy(points.astype(np.float32))
    return raycasting_scene(surface.vertices, surface.triangles).compute_occupancy(query).numpy() > 0


def test_warnings_of_the_solver_stay_out_of_the_terminal_and_nothing_else_does(capfd):
    with without_solver_warnings():
        os.write(2, b"before\n[WARNING] /root/a.inl (Line 1)\n          Extract\n          bad average roots: 2\n")
        os.write(2, b"[ERROR] /root/b.inl (Line 2)\n        Extract\n          no roots\n")
    os.write(2, b"after\n")
    assert (
        capfd.readouterr().err == "before\n[ERROR] /root/b.inl (Line 2)\n        Extract\n          no roots\nafter\n"
    )
