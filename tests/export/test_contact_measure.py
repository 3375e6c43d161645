"""The measure of collision geometry: exact touches, signs, holes, and what is inside."""

import mujoco
import numpy as np
import pytest
import trimesh

from realsim.core.types import TerrainMesh
from realsim.export import CONTACT
from realsim.export.any_mesh import contact_verdict
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_plane
from realsim.export.contact.boxes import boxes
from realsim.export.contact.cost import standing_place
from realsim.export.contact.fidelity import FAULTLESS, Region, g1_foot, measure
from realsim.export.contact.leaks import count_leaks
from realsim.export.contact.prisms import as_contact
from realsim.export.contact.probe import BALL, Reference, SimTouch, first_touch, spec_of
from realsim.export.contact.shape import Shape
from realsim.export.contact.sides import FREE, free_side_figures, side_figures
from tests.export.measured import CONFIG, FACING_UP, fidelity, reference
from tests.truths.solids import block, terrain, with_floor


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


def test_of_no_points_and_no_rays_nothing_is_known() -> None:
    surface, none = reference(with_floor(block(0, 0, 0.2, 0.2, 0.2))), np.zeros((0, 3))
    assert surface.distance(none).shape == (0,)
    assert surface.normals(none).shape == (0, 3)
    assert [len(found) for found in surface.cast(none, none)] == [0, 0, 0]
    assert surface.buried(none).shape == (0,)


def test_inside_of_overlapping_solids_is_inside() -> None:
    """A beam sunk into the post that carries it: its underside lies within the post."""
    post, beam = block(0, 0, 0.2, 0.2, 0.2), block(0, 0, 0.8, 0.2, 0.3, bottom=0.196)
    parts = [with_floor(part) for part in (post, beam)]
    apart = [parts[0].triangles, parts[1].triangles + len(parts[0].vertices)]
    both = Reference(np.vstack([part.vertices for part in parts]), np.vstack(apart))
    points = np.array([[0, 0, 0.1], [0.3, 0, 0.1], [0.3, 0, 0.25]])
    np.testing.assert_array_equal(both.buried(points), [True, False, True])


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


def test_a_ball_between_parts_of_a_thin_thing_is_held() -> None:
    """A plate of 3 cm has no place 15 mm deep; a ball that its halves push into each other stays all the same."""
    mesh = with_floor(block(0, 0, 0.12, 0.12, 0.03))
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    halves = [signs * [0.03, 0.06, 0.015] + [x, 0, 0.015] for x in (-0.03, 0.03)]
    meeting = as_contact("x", [], (floor_plane(0.0),), {}, halves)
    whole = ContactModel("x", (floor_plane(0.0), Geom("a", "box", (0, 0, 0.015), size=(0.06, 0.06, 0.015))))
    found = [measure(spec_of(c), reference(mesh), 0.0, probes=200, feet=0).figures for c in (meeting, whole)]
    assert found[0]["held"] > 0
    assert found[1]["leaks"] == found[1]["held"] == 0
    said = {**found[0], "hidden_cm2": 0.0}
    assert contact_verdict(said, (0.005, 0.015))["level"] == "look"
    assert found[1]["leak_objects"] > 50, "most of them land on it and stay"


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


def test_a_ray_that_meets_something_invented_first_does_not_count() -> None:
    """A wall that no camera saw stands before one that was seen: from its far side nothing counts."""

    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1])
    for x in (0.0, 2.05):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 2, 1], pos=[x, 0, 1])
    floor = trimesh.creation.box((6, 4, 0.02), trimesh.transformations.translation_matrix((0, 0, -0.01)))
    seen = trimesh.creation.box((0.1, 4, 2), trimesh.transformations.translation_matrix((2.05, 0, 1)))
    guess = trimesh.creation.box((0.1, 4, 2), trimesh.transformations.translation_matrix((0, 0, 1)))
    whole = trimesh.util.concatenate([floor, seen, guess])
    invented = np.arange(len(whole.faces)) >= len(floor.faces) + len(seen.faces)
    vertices, faces = np.asarray(whole.vertices, float), np.asarray(whole.faces, np.int32)
    low, high = np.array([-2.0, -1.5]), np.array([-0.5, 1.5])
    touch = SimTouch(spec, BALL)
    assert side_figures(touch, Reference(vertices, faces, invented), low, high, 0.0)["rays"] == 0
    low, high = np.array([0.5, -1.5]), np.array([1.5, 1.5])
    between = side_figures(touch, Reference(vertices, faces, invented), low, high, 0.0)
    assert between["rays"] > 50
    assert between["stopped"] == 1.0


def test_a_pillar_below_what_floats_stands_in_free_air_and_a_block_below_a_sheet_does_not() -> None:

    def figures(drawn, *solid) -> dict:
        """Of boxes, (size, middle) each."""
        spec = mujoco.MjSpec()
        for size, middle in solid:
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(size) / 2, pos=middle)
        vertices, faces = np.asarray(drawn.vertices, float), np.asarray(drawn.faces, np.int32)
        return free_side_figures(SimTouch(spec, BALL), Reference(vertices, faces), 0.0)

    def drawn(size, middle):
        return trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle))

    platform, speck = ((0.6, 0.6, 0.1), (0, 0, 0.05)), ((0.05, 0.05, 0.05), (0.1, 0, 0.9))
    mesh = trimesh.util.concatenate([drawn(*platform), drawn(*speck)])
    assert figures(mesh, platform, speck)["free_sides_cm2"] == 0
    assert contact_verdict(FAULTLESS | {"hidden_cm2": 0.0}, CONFIG.contact_tolerance)["level"] == "good"
    found = figures(mesh, platform, ((0.05, 0.05, 0.825), (0.1, 0, 0.5125)))
    assert found["free_sides_cm2"] == pytest.approx(4 * 5 * (87.5 - 10 - 2 * 3), rel=0.1)
    assert found["free_sides_cm2"] > FREE
    verdict = contact_verdict(FAULTLESS | {"hidden_cm2": 0.0} | found, CONFIG.contact_tolerance)
    assert verdict["level"] == "look"
    assert "free air, about (0.10, 0.00," in verdict["headline"]
    assert found["free_sides_at"][:2] == pytest.approx([0.1, 0], abs=0.01)
    sheet = trimesh.Trimesh(
        [[-0.3, -0.3, 0.5], [0.3, -0.3, 0.5], [0.3, 0.3, 0.5], [-0.3, 0.3, 0.5]], [[0, 1, 2], [0, 2, 3]]
    )
    assert figures(sheet, ((0.61, 0.61, 0.5), (0, 0, 0.25)))["free_sides_cm2"] == 0


def test_a_thing_that_most_balls_roll_off_is_thrown_at_again() -> None:
    """Off a post, all but a few; as many as half of a throw have to stay before nothing held means anything."""
    post = trimesh.creation.cylinder(0.03, 0.2)
    touch = SimTouch(spec_of(ContactModel("x", (Geom("a", "box", (0, 0, 0), size=(0.02, 0.02, 0.1)),))), BALL)
    around = Reference(np.asarray(post.vertices), np.asarray(post.faces, np.int32))
    found = count_leaks(touch, around, post.bounds[0, :2] - 0.05, post.bounds[1, :2] + 0.05, -0.1, objects=40)
    assert 20 <= found["leak_objects"] < 60
    assert len(found["leak_places"]) == found["leaks"] + found["held"]
