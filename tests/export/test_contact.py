"""Contact that matches the mesh: measured through contacts, for representations and for the measure itself."""

import itertools

import mujoco
import numpy as np
import pytest
import trimesh

from realsim.core.errors import UnknownNameError
from realsim.core.types import MeshQuality, TerrainMesh
from realsim.export import CONTACT
from realsim.export.any_mesh import heatmap_png
from realsim.export.config import SceneConfig
from realsim.export.contact import cost
from realsim.export.contact.base import ContactModel, Geom, floor_plane
from realsim.export.contact.boxes import boxes
from realsim.export.contact.choose import fit_contact
from realsim.export.contact.fidelity import Fidelity
from realsim.export.contact.probe import BALL, SimTouch, first_touch, spec_of
from realsim.export.contact.seams import open_seams, parts_of
from realsim.export.contact.shape import Shape, Solids
from tests.export.measured import CONFIG, FACING_UP, boxes_of, fidelity
from tests.truths.solids import TERRAINS, block, grid_mesh, terrain, with_floor


@pytest.mark.parametrize("name", list(TERRAINS))
def test_boxes_match_exact_terrains(name: str) -> None:
    """The project's bars, on solids whose surface is known; no seam between the parts is left open."""
    mesh = terrain(name)
    assert not open_seams(parts_of(boxes_of(name))[0])
    f = fidelity(boxes_of(name), mesh, probes=400, feet=20)
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


def test_standing_on_boxes_costs_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "STEPS", 50)
    monkeypatch.setattr(cost, "REPEATS", 5)
    assert cost.step_cost(spec_of(boxes_of("stakes")), np.array([0, 0, 0.35]))["step_cost_vs_plane"] <= 2.5


def test_stakes_are_boxes_and_wedges_are_prisms() -> None:
    assert {g.type for g in boxes_of("stakes").geoms} == {"plane", "box"}
    assert sum(g.type == "mesh" for g in boxes_of("wedges").geoms) == 3


def test_the_same_mesh_gives_the_same_geoms() -> None:
    one, two = boxes_of("trapezoids"), boxes(Shape(terrain("trapezoids"), 0.0), CONFIG)
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


def test_nothing_sinks_into_a_height_field() -> None:
    points, faces = grid_mesh(lambda x, y: 0.2 * np.sin(2 * x) * np.cos(3 * y) + 0.2, 4.0, 60)
    quality = MeshQuality(len(points), len(faces), False, True, 0, 0, 1, None)
    mesh = TerrainMesh(points, faces.astype(np.int32), None, np.zeros(len(faces), bool), quality, "made", 0.0)
    f = fidelity(CONTACT["hfield"](Shape(mesh, 0.0), CONFIG), mesh, probes=900, feet=0)
    assert f["leaks"] == 0
    assert f["p95_mm"] < 1


def test_convex_parts_of_an_overhang() -> None:
    mesh = with_floor(block(0, 0, 0.06, 0.1, 0.2) + block(0.05, 0, 0.16, 0.1, 0.2, 0.16))
    contact = CONTACT["convex"](Shape(mesh, 0.0), CONFIG)
    f = fidelity(contact, mesh, probes=400, feet=0)
    assert f["p95_mm"] < 10
    assert f["phantom_area_cm2"] == 0


def test_convex_keeps_the_pieces_that_are_convex_already() -> None:
    mesh = with_floor(block(0, 0, 0.1, 0.1, 0.2))
    corners = np.array(list(itertools.product((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.2))))
    contact = CONTACT["convex"](Shape(mesh, 0.0, Solids((corners,), None)), CONFIG)
    assert contact.statistics["parts"] == len(contact.geoms) - 1 == 1


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


def test_the_least_bad_leaks_little_and_leaves_the_air_free() -> None:
    """Leaks weigh more than errors, but not so much that a room filled up to its ceiling wins by leaking less."""

    def shortfall(leaks: int, p95: float, stopped: float | None = None) -> float:
        figures = {"leaks": leaks, "leak_objects": 150, "median_mm": 1.0, "p95_mm": p95, "phantom_over_gaps_cm2": 0.0}
        figures |= {"drop": {"phantom_share": 0.0, "missing_share": 0.0}, "sides": {"stopped": stopped, "rays": 900}}
        return Fidelity(figures, touches=None).shortfall(0.005, 0.015)  # type: ignore[arg-type]

    assert shortfall(1, 16) < shortfall(3, 16) < shortfall(120, 1)
    assert shortfall(0, 40) < shortfall(10, 16)
    assert shortfall(12, 30, 0.97) < shortfall(2, 50, 0.01)
    fitted = fit_contact(terrain("stairs"), 0.0, SceneConfig(contact_tolerance=(1e-9, 1e-9), contact_probes=200))
    assert "best of 4 candidates" in fitted.warnings[-1]
    assert fitted.summary["leaks"] == 0
    assert len(fitted.summary["considered"]) == 4


def test_unknown_representation() -> None:
    with pytest.raises(UnknownNameError, match="auto"):
        fit_contact(terrain("stakes"), 0.0, SceneConfig(contact="boxen"))
