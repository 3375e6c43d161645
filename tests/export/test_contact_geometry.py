"""What collision geometry is made from: columns, planes, outlines, solids."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from realsim.core.types import TerrainMesh
from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel, Geom, floor_plane
from realsim.export.contact.boxes import boxes
from realsim.export.contact.columns import columns
from realsim.export.contact.fidelity import measure
from realsim.export.contact.islands import terrain as islands
from realsim.export.contact.outline import area, convex_parts, hull, outlines
from realsim.export.contact.planes import heights, misfit, segment, spread
from realsim.export.contact.probe import Reference, spec_of
from realsim.export.contact.shape import Shape
from realsim.export.contact.solids import island_solid
from realsim.export.mend import mend
from tests.truths.solids import block, terrain, with_floor


def test_columns_of_a_bridge_have_a_gap() -> None:
    mesh = with_floor(block(0, 0, 0.4, 0.1, 0.3, 0.2))
    grid = columns(mesh, 0.0, 0.01)
    row, column = (np.rint((0 - grid.lower[k]) / grid.cell).astype(int) for k in (1, 0))
    assert grid.top[0, row, column] == pytest.approx(0.3, abs=1e-5)
    assert grid.bottom[0, row, column] == pytest.approx(0.2, abs=1e-5)
    assert grid.top[1, row, column] == pytest.approx(0.0, abs=1e-5)
    assert grid.bottom[1, row, column] == -np.inf


def table() -> TerrainMesh:
    """Four legs that end exactly at the underside of the top."""
    parts = [trimesh.creation.box([0.06, 0.06, 0.5]) for _ in range(4)] + [trimesh.creation.box([0.8, 0.6, 0.04])]
    places = [(x, y, 0.25) for x in (-0.3, 0.3) for y in (-0.2, 0.2)] + [(0.0, 0.0, 0.52)]
    for part, place in zip(parts, places, strict=True):
        part.apply_translation(place)
    whole = trimesh.util.concatenate(parts)
    return mend(np.asarray(whole.vertices), np.asarray(whole.faces)).terrain


def test_faces_that_lie_in_each_other_both_count() -> None:
    grid = columns(table(), 0.0, 0.01)
    row, column = (np.rint((at - grid.lower[k]) / grid.cell).astype(int) for k, at in ((1, 0.2), (0, 0.3)))
    assert grid.bottom[0, row, column] == -np.inf, "the leg reaches the ground"
    row, column = (np.rint((0 - grid.lower[k]) / grid.cell).astype(int) for k in (1, 0))
    assert grid.bottom[0, row, column] == pytest.approx(0.5, abs=1e-5)


def test_legs_under_a_top_are_missed_where_they_are_not_there() -> None:
    """From above nothing is wrong with a table top that floats."""
    mesh = table()
    reference = Reference(mesh.vertices, mesh.triangles)
    top = ContactModel("x", (floor_plane(0.0), Geom("top", "box", (0.0, 0.0, 0.52), size=(0.4, 0.3, 0.02))), ())
    floating = measure(spec_of(top), reference, 0.0, probes=300, feet=0, bare=True)
    assert floating.figures["missing_area_cm2"] == 0
    assert floating.figures["sides"]["through"] > 0.03
    assert not floating.meets(0.005, 0.015)
    standing = measure(spec_of(boxes(Shape(mesh, 0.0), SceneConfig())), reference, 0.0, probes=300, feet=0, bare=True)
    assert standing.figures["sides"]["through"] == 0
    assert standing.meets(0.005, 0.015)


def test_overlapping_solids_are_one_interval() -> None:
    parts = [trimesh.creation.box([0.2, 0.2, 0.2]), trimesh.creation.box([0.2, 0.2, 0.2])]
    parts[1].apply_translation([0, 0, 0.15])
    both = trimesh.util.concatenate(parts)
    quality = terrain("stairs").quality
    mesh = TerrainMesh(
        np.asarray(both.vertices),
        np.asarray(both.faces, np.int32),
        None,
        np.zeros(len(both.faces), bool),
        quality,
        "",
        0,
    )
    grid = columns(mesh, -1.0, 0.01)
    assert len(grid.top) == 1
    assert np.nanmin(grid.top) == pytest.approx(0.25, abs=1e-5)
    assert np.nanmax(grid.bottom[np.isfinite(grid.top)]) == pytest.approx(-0.1, abs=1e-5)


def test_segment_finds_the_planes_of_a_roof() -> None:
    rows, cols = np.indices((40, 60))
    z = 0.005 * np.minimum(cols, 59 - cols) * 0.5 + 0.001 * rows
    found = segment(z, 0.005, 0.003)
    assert found is not None
    labels, planes = found
    assert len(planes) == 2
    assert (labels >= 0).all()
    fitted = np.where(labels == 0, heights(planes[0], z.shape), heights(planes[1], z.shape))
    np.testing.assert_allclose(fitted, z, atol=0.003)


def test_rolling_ground_is_not_made_of_planes() -> None:
    rows, cols = np.indices((600, 600)) * 0.01
    assert segment(0.3 * np.sin(2 * cols) * np.cos(3 * rows), 0.01, 0.003) is None


def test_spread_cuts_a_blurred_edge_half_way() -> None:
    z = np.array([[0.2, 0.2, 0.18, 0.12, 0.06, 0.01]])
    labels = np.array([[0, 0, -1, -1, -1, -1]])
    out = spread(labels, np.ones_like(z, bool), misfit(z, np.array([[0.0, 0.0, 0.2]])), np.abs(z))
    assert (out[0, :4] == 0).all()
    assert out[0, 5] == -1


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 9), st.floats(0, 6.28), st.randoms(use_true_random=False))
def test_convex_parts_cover_a_polygon_once(n: int, turn: float, random) -> None:
    """Star-shaped polygons: parts are convex, and their areas add up."""
    angle = turn + np.linspace(0, 2 * np.pi, n, endpoint=False)
    radius = np.array([random.uniform(1, 5) for _ in range(n)])
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)
    parts = convex_parts([ring], 0.0)
    assert sum(area(p) for p in parts) == pytest.approx(abs(area(ring)), rel=1e-4)
    for part in parts:
        assert area(hull(part)) == pytest.approx(area(part), rel=1e-9)


def test_outline_of_a_turned_square_is_a_square() -> None:
    rows, cols = np.indices((120, 120))
    c, s = np.cos(0.4), np.sin(0.4)
    u, v = c * (rows - 60) + s * (cols - 60), -s * (rows - 60) + c * (cols - 60)
    (ring,) = outlines((np.abs(u) < 30) & (np.abs(v) < 30), 0.8)
    assert len(ring) == 4
    assert abs(area(ring)) == pytest.approx(3600, rel=0.01)
    np.testing.assert_allclose(np.hypot(*(ring - 60).T), 30 * 2**0.5, atol=0.6)


def test_corners_that_a_mesh_rounded_are_sharp_again() -> None:
    rows, cols = np.indices((120, 140))
    u, v = np.abs(rows - 60) - 37, np.abs(cols - 70) - 47
    rounded = np.hypot(np.maximum(u, 0), np.maximum(v, 0)) < 3
    (ring,) = outlines(rounded, 1.0)
    assert len(ring) == 4
    np.testing.assert_allclose(np.abs(ring - [60, 70]), np.tile([39.5, 49.5], (4, 1)), atol=0.6)


def test_a_ring_keeps_its_hole() -> None:
    rows, cols = np.indices((80, 80))
    r = np.hypot(rows - 40, cols - 40)
    parts = convex_parts(outlines((r < 30) & (r > 15), 0.8), 0.8)
    assert not any(_contains(p, [40, 40]) for p in parts)
    assert sum(area(p) for p in parts) == pytest.approx(np.pi * (900 - 225), rel=0.05)


def _contains(ring: np.ndarray, point: list[float]) -> bool:
    a, b = ring, np.roll(ring, -1, axis=0)
    return bool((((b - a)[:, 0] * (point[1] - a[:, 1]) - (b - a)[:, 1] * (point[0] - a[:, 0])) > 0).all())


def test_solids_are_closed_and_of_the_right_size() -> None:
    whole = islands(with_floor(block(0, 0, 0.2, 0.3, 0.15)), 0.0, 0.01)
    vertices, faces = island_solid(whole, whole.islands[0])
    solid = trimesh.Trimesh(vertices, faces)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(0.2 * 0.3 * 0.17, rel=0.05)
