"""Contact that matches the mesh: measured through contacts, for representations and for the measure itself."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.solids import TERRAINS, block, terrain, with_floor
from realsim.errors import UnknownNameError
from realsim.export import CONTACT
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_plane
from realsim.export.contact.boxes import boxes
from realsim.export.contact.choose import fit_contact
from realsim.export.contact.columns import columns
from realsim.export.contact.cost import standing_place, step_cost
from realsim.export.contact.fidelity import Fidelity, Region, g1_foot, measure
from realsim.export.contact.heatmap import heatmap_png
from realsim.export.contact.outline import area, convex_parts, hull, outlines
from realsim.export.contact.planes import heights, segment, spread
from realsim.export.contact.probe import BALL, Reference, SimTouch, first_touch, spec_of
from realsim.export.contact.shape import Shape
from realsim.export.contact.solids import island_solid
from realsim.types import TerrainMesh

CONFIG = SceneConfig()
FACING_UP = np.array([1.0, 0, 0, 0])


def reference(mesh: TerrainMesh) -> Reference:
    return Reference(mesh.vertices, mesh.triangles)


def fidelity(contact: ContactModel, mesh: TerrainMesh, **kwargs) -> dict:
    return dict(measure(spec_of(contact), reference(mesh), 0.0, **kwargs).figures)


@pytest.mark.parametrize("name", list(TERRAINS))
def test_boxes_match_exact_terrains(name: str) -> None:
    """The project's bars, on solids whose surface is known."""
    mesh = terrain(name)
    f = fidelity(boxes(Shape(mesh, 0.0), CONFIG), mesh, probes=900, feet=40)
    assert f["median_mm"] <= 3
    assert f["p95_mm"] <= 10
    assert f["max_mm"] <= 15
    assert f["phantom_area_cm2"] == 0
    assert f["missing_area_cm2"] == 0
    assert f["leaks"] == 0
    assert f["pushed"]["max_mm"] <= 15
    assert f["feet"]["max_mm"] <= 15
    assert f["drop"]["p95_mm"] <= 20
    assert f["drop"]["phantom_share"] <= 0.01
    assert f["drop"]["missing_share"] <= 0.01


def test_standing_on_boxes_costs_little() -> None:
    contact = boxes(Shape(terrain("stakes"), 0.0), CONFIG)
    assert step_cost(spec_of(contact), np.array([0, 0, 0.35]))["step_cost_vs_plane"] <= 2.5


def test_stakes_are_boxes_and_wedges_are_prisms() -> None:
    kinds = {g.type for g in boxes(Shape(terrain("stakes"), 0.0), CONFIG).geoms}
    assert kinds == {"plane", "box"}
    wedges = boxes(Shape(terrain("wedges"), 0.0), CONFIG)
    assert sum(g.type == "mesh" for g in wedges.geoms) == 3


def test_the_same_mesh_gives_the_same_geoms() -> None:
    mesh = terrain("trapezoids")
    one, two = boxes(Shape(mesh, 0.0), CONFIG), boxes(Shape(mesh, 0.0), CONFIG)
    assert one.geoms == two.geoms
    assert [a.attributes for a in one.assets] == [a.attributes for a in two.assets]


def test_a_noisy_one_sided_scan() -> None:
    """3 mm of noise on tops and floor, no undersides: still within the tolerance."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(-0.3, 0.7, 0.01), np.arange(-0.3, 0.3, 0.01))
    z = np.where((np.abs(x) < 0.15) & (np.abs(y) < 0.12), 0.2, 0.0)
    z = np.where((np.abs(x - 0.45) < 0.1) & (np.abs(y) < 0.12), 0.1, z)
    rows, cols = x.shape
    a = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + cols], 1), np.stack([a + 1, a + cols + 1, a + cols], 1)])
    clean = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    noisy = clean + np.column_stack([np.zeros((len(clean), 2)), rng.normal(0, 0.001, len(clean))])
    quality = terrain("stairs").quality
    mesh = TerrainMesh(noisy, faces.astype(np.int32), None, np.zeros(len(faces), bool), quality, "", 0.01, 0.002)
    f = fidelity(boxes(Shape(mesh, 0.0), CONFIG), mesh, probes=900, feet=0)
    assert f["median_mm"] < 3
    assert f["p95_mm"] < 10
    assert f["leaks"] == 0


def test_a_pit_stays_a_pit() -> None:
    """Ground that lies lower than the floor is not covered by it."""
    slab = block(0, 0, 2, 2, 0.0, -0.4) - block(0.3, 0, 0.4, 0.5, 0.1, -0.2)
    mesh = with_floor(slab, margin=-0.5)
    # The slab alone, without the sheet of floor that was added.
    mesh = TerrainMesh(mesh.vertices, mesh.triangles[:-2], None, mesh.invented[:-2], mesh.quality, "", 0.0)
    touch = SimTouch(spec_of(boxes(Shape(mesh, 0.0), CONFIG)), BALL)
    start = np.array([[0.3, 0.0, 0.3], [-0.4, 0.0, 0.3]])
    t = first_touch(touch.clearance, start, np.tile(FACING_UP, (2, 1)), np.tile([0, 0, -1.0], (2, 1)), 1.0)
    np.testing.assert_allclose(0.3 - t - 0.01, [-0.2, 0.0], atol=0.002)


def raised_board(invented_to: float, seen_walls: bool = True) -> TerrainMesh:
    """A board from 0.22 to 0.3 m; below it what a mesh fills in where no camera looked, down to `invented_to`."""
    board = trimesh.creation.box([0.5, 0.16, 0.08])
    board.apply_translation([0, 0, 0.26])
    keep = board.face_normals[:, 2] > -0.5
    fill = trimesh.creation.box([0.498, 0.158, 0.22 - invented_to])
    fill.apply_translation([0, 0, (0.22 + invented_to) / 2])
    fill.update_faces(fill.face_normals[:, 2] < 0.5)
    floor = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    board.update_faces(keep)
    parts = [board.subdivide().subdivide().subdivide(), fill, floor]
    whole = trimesh.util.concatenate(parts)
    invented = np.zeros(len(whole.faces), bool)
    first = len(parts[0].faces)
    invented[first : first + len(fill.faces)] = True
    if not seen_walls:
        invented[:first] = np.abs(parts[0].face_normals[:, 2]) < 0.5
    quality = terrain("stairs").quality
    return TerrainMesh(np.asarray(whole.vertices), np.asarray(whole.faces, np.int32), None, invented, quality, "", 0.01)


def underside(contact: ContactModel, x: float = 0.0) -> float:
    """z at which a ball pushed up below (x, 0) is stopped."""
    touch = SimTouch(spec_of(contact), BALL)
    start = np.array([[x, 0.0, 0.03]])
    return float(0.04 + first_touch(touch.clearance, start, FACING_UP[None], np.array([[0, 0, 1.0]]), 0.5)[0])


def test_an_underside_that_no_camera_saw_is_where_the_side_faces_end() -> None:
    contact = boxes(Shape(raised_board(0.12), 0.0), CONFIG)
    assert underside(contact) == pytest.approx(0.22, abs=0.003)
    assert contact.statistics["unseen_undersides_at_side_faces_cm2"] == pytest.approx(800, rel=0.1)
    assert contact.statistics["unseen_undersides_as_filled_cm2"] == 0


def test_without_side_faces_an_unseen_underside_stays_as_filled() -> None:
    contact = boxes(Shape(raised_board(0.12, seen_walls=False), 0.0), CONFIG)
    assert underside(contact) == pytest.approx(0.12, abs=0.003)
    assert contact.statistics["unseen_undersides_as_filled_cm2"] > 700


def test_phantom_over_a_gap_is_found_only_where_a_foot_fits() -> None:
    """A lid over a gap of 15 cm counts; one over a slit of 5 cm does not."""
    for gap, counts in ((0.15, True), (0.05, False)):
        y = (gap + 0.3) / 2
        mesh = with_floor(block(0, y, 0.6, 0.3, 0.2) + block(0, -y, 0.6, 0.3, 0.2))
        lid = Geom("lid", "box", (0, 0, 0.1), size=(0.3, y + 0.15, 0.1))
        f = fidelity(ContactModel("x", (floor_plane(0.0), lid)), mesh, probes=900, feet=0)
        assert (f["phantom_over_gaps_cm2"] > 0) == counts
        assert f["phantom_area_cm2"] > 0


# ---------------------------------------------------------------- the other representations


def test_hull_fills_the_gaps_and_the_measure_says_so() -> None:
    """The naive mesh, which rays call perfect."""
    mesh = terrain("stakes")
    f = fidelity(CONTACT["hull"](Shape(mesh, 0.0), CONFIG), mesh, probes=500, feet=0)
    assert f["median_mm"] > 20
    assert f["phantom_area_cm2"] > 5000


def test_a_height_field_turns_edges_into_ramps() -> None:
    mesh = terrain("stakes")
    f = fidelity(CONTACT["hfield"](Shape(mesh, 0.0), CONFIG), mesh, probes=900, feet=0)
    assert f["median_mm"] < 1
    assert f["drop"]["p95_mm"] > 10


def test_convex_parts_of_an_overhang() -> None:
    mesh = with_floor(block(0, 0, 0.06, 0.1, 0.2) + block(0.05, 0, 0.16, 0.1, 0.2, 0.16))
    contact = CONTACT["convex"](Shape(mesh, 0.0), CONFIG)
    f = fidelity(contact, mesh, probes=400, feet=0)
    assert f["p95_mm"] < 10
    assert f["phantom_area_cm2"] == 0


def test_hybrid_uses_convex_parts_for_what_is_not_planar() -> None:
    ball = trimesh.creation.icosphere(4, 0.15)
    from manifold3d import Manifold, Mesh

    dome = Manifold(Mesh(np.asarray(ball.vertices, np.float32), np.asarray(ball.faces, np.uint32)))
    contact = CONTACT["hybrid"](Shape(with_floor(dome + block(0.5, 0, 0.2, 0.2, 0.2)), 0.0), CONFIG)
    assert contact.statistics["convex_islands"] in (0, 1)
    f = fidelity(contact, with_floor(dome + block(0.5, 0, 0.2, 0.2, 0.2)), probes=500, feet=0)
    assert f["p95_mm"] < 10


def test_a_distance_field_compiles_and_holds_a_ball() -> None:
    mesh = with_floor(block(0, 0, 0.2, 0.2, 0.1))
    spec = spec_of(CONTACT["sdf"](Shape(mesh, 0.0), CONFIG))
    body = spec.worldbody.add_body(pos=[0, 0, 0.15])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], mass=0.1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=300)
    assert data.qpos[2] == pytest.approx(0.13, abs=0.005)


def test_auto_takes_the_cheapest_that_is_good_enough_and_says_what_it_measured() -> None:
    fitted = fit_contact(terrain("stairs"), 0.0, SceneConfig(contact_probes=400))
    s = fitted.summary
    assert s["representation"] == "boxes"
    expected = {"median_mm", "p95_mm", "max_mm", "phantom_area_cm2", "missing_area_cm2", "leaks", "step_cost_vs_plane"}
    assert expected <= set(s)
    assert fitted.warnings == ()
    assert heatmap_png(np.column_stack([fitted.fidelity.touches.start[:, :2], fitted.fidelity.touches.error]))


def test_what_is_not_met_is_said() -> None:
    fitted = fit_contact(terrain("stakes"), 0.0, SceneConfig(contact="hull", contact_probes=300))
    assert "phantom" in fitted.warnings[0]


def test_the_least_bad_is_the_one_that_leaks_least() -> None:
    """Leaks go before errors, and one ball more or less does not decide."""

    def shortfall(leaks: int, p95: float) -> tuple[int, float]:
        figures = {"leaks": leaks, "leak_objects": 150, "median_mm": 1.0, "p95_mm": p95, "phantom_over_gaps_cm2": 0.0}
        return Fidelity(figures, touches=None).shortfall(0.005, 0.015)  # type: ignore[arg-type]

    assert shortfall(0, 40) < shortfall(1, 16) < shortfall(120, 1)
    assert shortfall(40, 16) < shortfall(38, 30)
    fitted = fit_contact(terrain("stakes"), 0.0, SceneConfig(contact_tolerance=(1e-9, 1e-9), contact_probes=300))
    assert "least bad of 3, leaks first" in fitted.warnings[-1]
    assert fitted.summary["leaks"] == 0
    assert len(fitted.summary["considered"]) == 3


def test_unknown_representation() -> None:
    with pytest.raises(UnknownNameError, match="auto"):
        fit_contact(terrain("stakes"), 0.0, SceneConfig(contact="boxen"))


# ---------------------------------------------------------------- the measure


def shifted(mesh: TerrainMesh, dz: float) -> ContactModel:
    corners = np.array([[x, y, z + dz] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.05, 0.2)])
    return ContactModel("x", (floor_plane(0.0), Geom("b", "mesh", asset="b")), (Asset.of_points("b", corners),))


@pytest.mark.parametrize(("dz", "sign"), [(0.006, 1), (-0.006, -1)])
def test_a_shift_is_measured_as_it_is(dz: float, sign: int) -> None:
    """A top 6 mm too high is 6 mm of phantom; 6 mm too low, of missing surface."""
    mesh = with_floor(block(0, 0, 0.2, 0.2, 0.2))
    result = measure(spec_of(shifted(mesh, dz)), reference(mesh), 0.0, probes=400, feet=0)
    start = result.touches.start
    on_top = (np.abs(start[:, :2]) < 0.08).all(1)
    np.testing.assert_allclose(result.touches.error[on_top], sign * 0.006, atol=2e-4)


def test_floor_beyond_the_mesh_is_no_phantom_but_a_lid_is() -> None:
    """A block without any floor around it: nothing is known of what lies beside it."""
    two = block(-0.3, 0, 0.2, 0.6, 0.2) + block(0.3, 0, 0.2, 0.6, 0.2)
    mesh = with_floor(two)
    mesh = TerrainMesh(mesh.vertices, mesh.triangles[:-2], None, mesh.invented[:-2], mesh.quality, "", 0.0)
    good = fidelity(boxes(Shape(mesh, 0.0), CONFIG), mesh, probes=400, feet=0)
    assert good["phantom_area_cm2"] == 0
    assert fidelity(CONTACT["hull"](Shape(mesh, 0.0), CONFIG), mesh, probes=400, feet=0)["phantom_area_cm2"] > 1000


def test_touch_distances_and_normals_are_exact_on_a_box() -> None:
    spec = spec_of(ContactModel("x", (Geom("b", "box", (0, 0, 0.1), size=(0.1, 0.1, 0.1)),)))
    touch = SimTouch(spec, BALL, batch=4)
    start = np.array([[0, 0, 0.5], [0.5, 0, 0.1], [0.5, 0.5, 0.5], [0, 0, 0.1], [0.05, 0.05, 0.4]])
    direction = np.array([[0, 0, -1], [-1, 0, 0], [0, 0, -1], [0, 0, -1], [0, 0, -1.0]])
    quats = np.tile(FACING_UP, (5, 1))
    t = first_touch(touch.clearance, start, quats, direction, 0.6)
    np.testing.assert_allclose(t[[0, 1, 4]], [0.29, 0.39, 0.19], atol=5e-5)
    assert t[2] == np.inf
    assert np.isnan(t[3])
    at = start[:2] + t[:2, None] * direction[:2]
    np.testing.assert_allclose(touch.normals(at, quats[:2]), [[0, 0, 1], [1, 0, 0]], atol=1e-6)


def test_reference_knows_inside_from_outside() -> None:
    mesh = with_floor(block(0, 0, 0.2, 0.2, 0.2))
    ref = reference(mesh)
    points = np.array([[0, 0, 0.1], [0, 0, 0.3], [0.3, 0, 0.1], [0.3, 0, -0.1]])
    np.testing.assert_array_equal(ref.buried(points), [True, False, False, True])
    np.testing.assert_allclose(ref.top(points[:, :2]), [0.2, 0.2, 0, 0], atol=1e-5)


def test_a_foot_is_where_the_robot_has_it() -> None:
    foot = g1_foot()
    assert len(foot.ends) == 7
    assert foot.radius == 0.01
    np.testing.assert_allclose(foot.ends[:, :, 2], -0.025, atol=1e-3)
    np.testing.assert_allclose(np.ptp(foot.ends[:, :, 0]), 0.186, atol=1e-3)


def test_a_hole_in_the_collision_geometry_leaks() -> None:
    mesh = with_floor(block(0, 0, 0.5, 0.5, 0.2))
    hollow = ContactModel("x", (floor_plane(0.0),))
    assert measure(spec_of(hollow), reference(mesh), 0.0, probes=200, feet=0).figures["leaks"] > 10


def test_standing_place_is_high_level_and_not_at_the_rim() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    z = np.where((np.abs(x) < 0.4) & (np.abs(y) < 0.4), 0.3, 0.0)
    place = standing_place(np.column_stack([x.ravel(), y.ravel(), z.ravel()]))
    assert place[2] == 0.3
    assert np.abs(place[:2]).max() < 0.25


def test_region_holds_what_rises() -> None:
    region = Region.around(reference(terrain("stairs")), 0.0)
    assert region.lower[0] == pytest.approx(-0.5)
    assert region.top == pytest.approx(0.35, abs=1e-4)


# ---------------------------------------------------------------- geometry below


def test_columns_of_a_bridge_have_a_gap() -> None:
    mesh = with_floor(block(0, 0, 0.4, 0.1, 0.3, 0.2))
    grid = columns(mesh, 0.0, 0.01)
    row, column = (np.rint((0 - grid.lower[k]) / grid.cell).astype(int) for k in (1, 0))
    assert grid.top[0, row, column] == pytest.approx(0.3, abs=1e-5)
    assert grid.bottom[0, row, column] == pytest.approx(0.2, abs=1e-5)
    assert grid.top[1, row, column] == pytest.approx(0.0, abs=1e-5)
    assert grid.bottom[1, row, column] == -np.inf


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
    labels, planes = segment(z, 0.005, 0.003)
    assert len(planes) == 2
    assert (labels >= 0).all()
    fitted = np.where(labels == 0, heights(planes[0], z.shape), heights(planes[1], z.shape))
    np.testing.assert_allclose(fitted, z, atol=0.003)


def test_spread_cuts_a_blurred_edge_half_way() -> None:
    z = np.array([[0.2, 0.2, 0.18, 0.12, 0.06, 0.01]])
    labels = np.array([[0, 0, -1, -1, -1, -1]])
    out = spread(labels, np.ones_like(z, bool), lambda _: np.abs(z - 0.2), np.abs(z))
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
    from realsim.export.contact.islands import terrain as islands

    whole = islands(with_floor(block(0, 0, 0.2, 0.3, 0.15)), 0.0, 0.01)
    vertices, faces = island_solid(whole, whole.islands[0])
    solid = trimesh.Trimesh(vertices, faces)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(0.2 * 0.3 * 0.17, rel=0.05)
