"""Neighbouring parts reach into each other: what lands on a seam comes up again."""

import mujoco
import numpy as np
import pytest
from manifold3d import Manifold, OpType

from realsim.core.types import MeshQuality, TerrainMesh
from realsim.export.config import SceneConfig
from realsim.export.contact.base import ContactModel, Geom, floor_plane
from realsim.export.contact.boxes import boxes
from realsim.export.contact.merge import Whole, merged
from realsim.export.contact.polytope import Polytope
from realsim.export.contact.prisms import as_contact
from realsim.export.contact.probe import spec_of
from realsim.export.contact.seams import open_seams, overlap, parts_of
from realsim.export.contact.shape import Shape
from realsim.export.lint import lint_mjcf
from tests.truths.solids import block, grid_mesh, with_floor

CONFIG = SceneConfig()
FLUSH = [(0.0, 0.4, 0.2), (0.4, 0.4, 0.2), (0.8, 0.4, 0.35)]
"""x of the middle, length, height of boxes that only meet."""


def side_by_side() -> ContactModel:
    made = [Geom(f"b{k}", "box", (x, 0.0, h / 2), size=(a / 2, 0.3, h / 2)) for k, (x, a, h) in enumerate(FLUSH)]
    return ContactModel("boxes", (floor_plane(0.0), *made))


def settled(contact: ContactModel, places: np.ndarray, capsule: bool) -> np.ndarray:
    """(N,) height of things of 1 cm radius a second after they landed at 2 m/s at (N, 3)."""
    spec = spec_of(contact)
    rng = np.random.default_rng(0)
    for x, y, z in places:
        body = spec.worldbody.add_body(pos=[x, y, z + 0.011])
        body.add_freejoint()
        turn = rng.uniform(0, np.pi)
        end = 0.03 * np.array([np.cos(turn), np.sin(turn), 0])
        shape = {"fromto": [*-end, *end]} if capsule else {}
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE if capsule else mujoco.mjtGeom.mjGEOM_SPHERE
        body.add_geom(type=kind, size=[0.01, 0, 0], mass=0.03, contype=1, conaffinity=0, **shape)
    spec.memory = 2**26
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel.reshape(-1, 6)[:, 2] = -2.0
    mujoco.mj_step(model, data, nstep=500)
    return data.qpos.reshape(-1, 7)[:, 2]


@pytest.mark.parametrize("capsule", [False, True], ids=["ball", "capsule"])
def test_what_lands_on_a_seam_recovers_to_a_millimetre(capsule: bool) -> None:
    y = np.linspace(-0.2, 0.2, 5)
    flush = np.column_stack([np.full(5, 0.2), y, np.full(5, 0.2)])
    at = settled(overlap(side_by_side()), flush, capsule)
    np.testing.assert_allclose(at, 0.21, atol=1e-3)
    inner = flush + np.array([0.395, 0, 0])  # in the corner under the higher box
    np.testing.assert_allclose(settled(overlap(side_by_side()), inner, capsule), 0.21, atol=1e-3)
    if not capsule:
        assert (settled(side_by_side(), flush, capsule) < 0.2).any(), "parts that only meet hold it"


def test_overlap_changes_no_shape_and_boxes_stay_boxes() -> None:
    before, after = side_by_side(), overlap(side_by_side())
    assert [g.type for g in after.geoms] == ["plane", "box", "box"], "the two of one height are one"
    assert after.statistics["seams"] == 0
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.4, -0.5, -0.1], [1.2, 0.5, 0.5], (20_000, 3))
    inside = [np.any([p.contains(points) for p in parts_of(c)[0]], axis=0) for c in (before, after)]
    np.testing.assert_array_equal(*inside)
    assert len(open_seams(parts_of(before)[0])) == 2
    assert not open_seams(parts_of(after)[0])


def test_a_ridge_is_crossed_below_its_surface() -> None:
    """Two slopes that meet at the top: neither may go on straight."""
    left = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [1, 0, 0.3], [1, 1, 0.3]], float)
    right = left * [-1, 1, 1] + [2, 0, 0]
    contact = overlap(as_contact("boxes", [], (), {}, [left, right]))
    parts = parts_of(contact)[0]
    assert not open_seams(parts)
    rng = np.random.default_rng(0)
    points = rng.uniform([0.5, 0.1, 0.1], [1.5, 0.9, 0.4], (20_000, 3))
    above = points[:, 2] > 0.3 - 0.3 * np.abs(points[:, 0] - 1) + 0.004
    assert not any(p.contains(points[above]).any() for p in parts)


def test_a_seam_that_is_longer_on_both_sides_gets_a_part() -> None:
    crosswise = [
        Geom("a", "box", (0.0, 0.0, 0.1), size=(0.2, 0.3, 0.1)),
        Geom("b", "box", (0.4, 0.3, 0.15), size=(0.2, 0.3, 0.15)),
        Geom("c", "box", (0.4, -0.3, 0.05), size=(0.2, 0.29, 0.05)),
    ]
    contact = overlap(ContactModel("boxes", (floor_plane(0.0), *crosswise)))
    assert not open_seams(parts_of(contact)[0])


def test_a_seam_beside_a_face_that_bends_a_little_gets_a_part_where_a_ball_could_stay() -> None:
    """Its neighbour goes on at five degrees, and straight on from the seam nothing of it would be left."""
    tip, low, high = (0.0, 0.0), (0.16, -0.07), (0.16, 0.07)
    bent = [tip, high, (0.38, 0.185), (0.2, 0.3)]
    outlines = [[tip, low, high], bent, [(x, -y) for x, y in bent]]
    corners = [np.array([(x, y, z) for x, y in each for z in (0.0, 0.2)]) for each in outlines]
    before = as_contact("boxes", [], (floor_plane(0.0),), {}, corners)
    after = overlap(before)
    assert open_seams(parts_of(before)[0])
    assert not open_seams(parts_of(after)[0])
    along = np.linspace(0.4, 0.8, 11)[:, None] * high
    places = np.column_stack([along, np.full(11, 0.2)])
    assert (settled(before, places, False) < 0.2).any(), "parts that only meet hold it"
    np.testing.assert_allclose(settled(after, places, False), 0.21, atol=1e-3)


def test_a_seam_at_the_top_of_a_steep_side_gets_a_part_as_far_out_as_that_goes() -> None:
    """A deck of 4 cm, and a side under it that falls 2.5 for 1: 2 cm farther out, it is lower than the deck."""
    deck = np.array([[x, y, z] for x in (0.0, 0.2) for y in (-0.3, 0.3) for z in (0.16, 0.2)])
    side = np.array([[x, y, z] for x, z in ((0.195, 0.0), (0.195, 0.2), (0.275, 0.0)) for y in (-0.3, 0.3)])
    before = as_contact("boxes", [], (floor_plane(0.0),), {}, [deck, side])
    assert open_seams(parts_of(before)[0])
    after = parts_of(overlap(before))[0]
    assert not open_seams(after)
    points = np.random.default_rng(0).uniform([0.1, -0.3, 0.1], [0.3, 0.3, 0.25], (20_000, 3))
    above = points[:, 2] > 0.2 - 2.5 * np.maximum(points[:, 0] - 0.195, 0.0) + 0.015
    assert not any(p.contains(points[above]).any() for p in after), "nothing is added to the shape"


def test_pieces_of_a_convex_solid_are_one_part_and_a_dent_stays() -> None:
    """However it was cut: the hull of the pieces adds nothing. Over a gap, and in a corner, it would."""
    rings = [[[a * w, b * w, z] for a in (-1, 1) for b in (-1, 1)] for w, z in ((0.3, 0.0), (0.15, 0.25))]
    pieces = [Manifold.hull_points(np.concatenate(rings))]
    for way, off in (([1, 0.3, 0], 0.05), ([0, 1, 0.2], -0.02), ([0.2, 0, 1], 0.12)):
        pieces = [half for piece in pieces for half in piece.split_by_plane(way, off) if not half.is_empty()]
    parts = [Polytope(np.asarray(p.to_mesh64().vert_properties)[:, :3]) for p in pieces]
    assert len(parts) == 8
    (left,) = [p for p in merged(parts, Whole(parts, [])) if p is not None]
    assert len(left.points) == 8
    np.testing.assert_allclose([left.lower, left.upper], [[-0.3, -0.3, 0], [0.3, 0.3, 0.25]], atol=1e-6)
    for other in ((0.43, 0.2, 0.2), (0.4, 0.2, 0.3)):  # x of the middle, half its length, height
        x, half, high = other
        two = [
            Geom("a", "box", (0, 0, 0.1), size=(0.2, 0.3, 0.1)),
            Geom("b", "box", (x, 0, high / 2), size=(half, 0.3, high / 2)),
        ]
        parts = [Polytope.of_box(g) for g in two]
        assert merged(parts, Whole(parts, [])) == parts


def test_solids_that_cross_need_no_part_between_them() -> None:
    """Where a beam goes through a board, each pushes what gets in to its own free side."""
    crossed = [
        Geom("board", "box", (0, 0, 0.3), size=(0.3, 0.3, 0.06)),
        Geom("beam", "box", (0, 0, 0.3), quat=(0.924, 0.0, 0.383, 0.0), size=(0.06, 0.05, 0.5)),
    ]
    contact = overlap(ContactModel("boxes", (floor_plane(0.0), *crossed)))
    assert contact.statistics["seams"] == 0
    beside = np.column_stack([np.linspace(-0.25, 0.25, 21), np.full(21, 0.061), np.full(21, 0.36)])
    np.testing.assert_allclose(settled(contact, beside, False), 0.37, atol=1e-3)


def test_low_facets_of_a_hill_are_there() -> None:
    """Each is a speck for itself; together they are the foot of the hill."""
    vertices, triangles = grid_mesh(lambda x, y: 0.08 * np.exp(-(x**2 + y**2) / 0.12), 1.3, 26)
    quality = MeshQuality(len(vertices), len(triangles), False, True, 0, 0, 1, None)
    mesh = TerrainMesh(vertices, triangles.astype(np.int32), None, np.zeros(len(triangles), bool), quality, "", 0.0)
    parts, floor = parts_of(boxes(Shape(mesh, 0.0), CONFIG))
    risen = vertices[(vertices[:, 2] > 0.012) & (np.abs(vertices[:, :2]) < 0.6).all(1)]
    assert Whole(parts, floor).holds(risen - [0, 0, 0.008], 0.0)


def test_a_bin_has_its_thin_walls() -> None:
    """8 mm are less than two columns of a large terrain; a small exact mesh has finer ones."""
    solid = block(0, 0, 0.24, 0.2, 0.09, 0.0) - block(0, 0, 0.224, 0.184, 0.2, 0.004)
    parts = parts_of(boxes(Shape(with_floor(solid, 0.0), 0.0), CONFIG))[0]
    assert len(parts) == 4
    around = [[a * 0.116, b * 0.07, 0.085] for a in (-1, 1) for b in (-1, 0, 1)]
    around += [[a * 0.08, b * 0.096, 0.085] for a in (-1, 0, 1) for b in (-1, 1)]
    assert Whole(parts, []).holds(np.array(around), 0.0)
    assert not Whole(parts, []).holds(np.array([[0.0, 0.0, 0.05]]), 0.01)


def test_a_top_with_several_undersides_is_carried_by_one_part() -> None:
    """No seam where feet stand: a table's top is one part over its legs, the deck of an arch one over what curves."""
    hole = Manifold.cylinder(2, 0.3, 0.3, 32, True).rotate([90, 0, 0])
    legs = [block(0.4 * a, 0.3 * b, 0.06, 0.06, 0.7) for a in (-1, 1) for b in (-1, 1)]
    table = Manifold.batch_boolean([block(0, 0, 1.0, 0.7, 0.72, 0.68), *legs], OpType.Add)
    for solid, top, parts in ((block(0, 0, 0.9, 0.5, 0.45) - hole, 0.45, None), (table, 0.72, 5)):
        contact = boxes(Shape(with_floor(solid), 0.0), CONFIG)
        made = parts_of(contact)[0]
        assert sum(p.upper[2] > top - 0.005 for p in made) == 1
        assert parts is None or len(made) == parts
        xy = np.column_stack([np.linspace(-0.4, 0.4, 25), np.full(25, 0.05)])
        for capsule in (False, True):
            at = settled(contact, np.column_stack([xy, np.full(25, top)]), capsule)
            np.testing.assert_allclose(at, top + 0.01, atol=1e-3)


def test_a_mirror_image_has_as_many_parts() -> None:
    solid = block(0, 0, 0.3, 0.8, 0.15) + block(0.3, 0, 0.3, 0.8, 0.3) + block(0.6, 0, 0.3, 0.8, 0.45)
    counts = [len(boxes(Shape(with_floor(s), 0.0), CONFIG).geoms) for s in (solid, solid.mirror([1, 0, 0]))]
    assert counts[0] == counts[1] == 4


def test_narrow_boxes_are_written_as_meshes() -> None:
    """A capsule whose axis gets into a narrow box is sent the wrong way by MuJoCo; through a mesh it is not."""
    beam = [Geom("beam", "box", (0.0, 0.0, 0.2), size=(0.04, 0.5, 0.2))]
    contact = overlap(ContactModel("boxes", (floor_plane(0.0), *beam)))
    assert [g.type for g in contact.geoms] == ["plane", "mesh"]
    places = np.column_stack([np.zeros(5), np.linspace(-0.3, 0.3, 5), np.full(5, 0.4)])
    np.testing.assert_allclose(settled(contact, places, True), 0.41, atol=1e-3)


def test_sections_and_faces_of_a_part() -> None:
    cube = Polytope.of_points("cube", np.array([[a, b, c] for a in (0, 1) for b in (0, 2) for c in (0, 3)], float))
    assert cube.box is not None
    assert len(cube.faces) == 6
    top = next(f for f in cube.faces if f.normal[2] > 0.9)
    assert np.ptp(cube.section(top, -1.5), axis=0).prod() == pytest.approx(2.0)
    assert len(cube.section(top, 0.1)) == 0


def test_lint_names_hulls_and_seams(tmp_path) -> None:
    ell = [(0, 0), (1, 0), (1, 0.3), (0.3, 0.3), (0.3, 1), (0, 1)]
    vertices = " ".join(f"{x} {y} {z}" for z in (0, 0.2) for x, y in ell)
    sides = " ".join(f"{k} {(k + 1) % 6} {(k + 1) % 6 + 6} {k} {(k + 1) % 6 + 6} {k + 6}" for k in range(6))
    caps = "0 2 1 0 3 2 0 5 3 3 5 4 6 7 8 6 8 9 6 9 11 9 10 11"
    path = tmp_path / "user.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="L" vertex="{vertices}" face="{sides} {caps}"/></asset><worldbody>'
        '<geom type="plane" size="0 0 1"/><body name="terrain"><geom name="ell" type="mesh" mesh="L"/>'
        '<geom name="a" type="box" size=".2 .2 .1" pos="2 0 .1"/><geom name="b" type="box" size=".2 .2 .1" '
        'pos="2.4 0 .1"/></body><body pos="0 0 2"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    found = lint_mjcf(path)
    assert [h["geom"] for h in found["hulls"]] == ["ell"]
    assert [s["geoms"] for s in found["seams"]] == [["a", "b"]]
    assert found["seams"][0]["at"] == pytest.approx([2.2, 0.0, 0.1], abs=0.02)
    assert found["verdict"]["level"] != "good"
    assert found["phantom_over_gaps_cm2"] > 500
