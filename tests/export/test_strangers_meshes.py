"""Meshes as strangers have them: the same scene as of the clean file, or a sentence that says why not."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, FillRule, Manifold
from scipy.spatial import Delaunay

from realsim.capture.scanfile import read_scan
from realsim.core.errors import ExportError, RealsimError
from realsim.core.types import TerrainMesh
from realsim.export import contact_mesh
from realsim.export.config import SceneConfig
from realsim.export.contact.boxes import boxes
from realsim.export.contact.choose import fit_contact, is_exact
from realsim.export.contact.islands import terrain
from realsim.export.contact.probe import BALL, SimTouch, spec_of
from realsim.export.contact.seams import parts_of
from realsim.export.contact.shape import Shape
from realsim.export.contact.sheets import sheets
from realsim.export.ground import ground_level
from realsim.export.mend import mend, read_mesh
from realsim.export.pieces import convex_solids, without_twins
from tests.truths.scanned_rooms import closet
from tests.truths.solids import grid_mesh

STEPS = [((0.3 * k + 0.15, 0, 0.075 * (k + 1)), (0.3, 1.0, 0.15 * (k + 1))) for k in range(3)]
FLOOR = ((0.5, 0, -0.05), (3.0, 2.0, 0.1))


def put_together(*boxes: tuple) -> trimesh.Trimesh:
    """Boxes (middle, size) as they are, in one mesh."""
    parts = [trimesh.creation.box(size).apply_translation(middle) for middle, size in boxes]
    return trimesh.util.concatenate(parts)


def sheet(height, size: float = 4.0, cells: int = 40) -> trimesh.Trimesh:
    """An open surface over a square."""
    return trimesh.Trimesh(*grid_mesh(height, size, cells), process=False)


def as_terrain(mesh: trimesh.Trimesh):
    return mend(np.asarray(mesh.vertices, float), np.asarray(mesh.faces)).terrain


@pytest.mark.parametrize(
    "height",
    [
        lambda x, y: x * np.tan(np.radians(4)),
        lambda x, y: 0.4 * x - 0.2 * y,
        lambda x, y: 0.3 * np.sin(2 * x) * np.cos(1.7 * y),
        lambda x, y: 0.1 * np.hypot(x, y),
        lambda x, y: 0.02 * np.random.default_rng(0).normal(size=x.shape) + 0.1 * x,
    ],
    ids=["4 degrees", "two ways", "rolling", "cone", "rough"],
)
@pytest.mark.parametrize("lift", [0.0, -2.3])
def test_ground_of_slopes_is_not_above_their_lowest_part(height, lift: float) -> None:
    mesh = as_terrain(sheet(lambda x, y: height(x, y) + lift))
    assert ground_level(mesh).z <= mesh.vertices[:, 2].min() + 1e-3


def test_map_coordinates_give_the_scene_of_the_local_file(tmp_path: Path) -> None:
    mesh = put_together(FLOOR, *STEPS)
    found = []
    for name, offset in (("local", np.zeros(3)), ("map", np.array([484213.37, 5457120.61, 312.48]))):
        path = tmp_path / f"{name}.obj"
        rows = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices + offset]
        path.write_text("\n".join([*rows, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces)]))
        out = tmp_path / name
        out.mkdir()
        found.append(contact_mesh(path, out, SceneConfig(contact_probes=200)).contact)
    assert [c["geoms"] for c in found] == [{"plane": 1, "box": 3}] * 2
    assert [c["verdict"]["level"] for c in found] == ["good"] * 2
    assert found[1]["origin_m"] == [484212.0, 5457119.0, 312.0]
    assert any("add (484212, 5457119, 312) m" in note for note in found[1]["mended"])


def test_what_begins_at_zero_once_it_was_moved_does_not_stand_on_it(tmp_path: Path) -> None:
    mesh = sheet(lambda x, y: 0.3 * np.sin(2 * x) * np.cos(1.7 * y))
    rows = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in mesh.vertices + np.array([691002.0, 5335002.0, 512.0])]
    (tmp_path / "a.obj").write_text("\n".join([*rows, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces)]))
    made = read_mesh(tmp_path / "a.obj")
    assert (made.up.axis, made.up.question) == ("z", None)
    assert made.terrain.vertices[:, 1].min() == 0


def test_map_coordinates_in_single_precision_are_refused(tmp_path: Path) -> None:
    mesh = put_together(*STEPS)
    mesh.apply_translation([484213.37, 5457120.61, 312.48])
    mesh.export(tmp_path / "a.stl")
    with pytest.raises(ExportError, match=r"lost their precision[\s\S]*steps of 0\.5 m"):
        read_mesh(tmp_path / "a.stl")


def test_large_numbers_about_the_origin_are_another_unit(tmp_path: Path) -> None:
    mesh = put_together(*STEPS)
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "a.stl")
    with pytest.raises(ExportError, match="--unit mm"):
        read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize("kind", ["again", "from behind", "a third again"])
def test_triangles_that_are_there_twice(kind: str) -> None:
    mesh = put_together(*STEPS)
    faces = np.asarray(mesh.faces)
    more = {"again": np.roll(faces, 1, 1), "from behind": faces[:, ::-1], "a third again": faces[::3]}[kind]
    made = mend(np.asarray(mesh.vertices), np.concatenate([faces, more]))
    assert any(f"{len(more)} triangles that were there twice" in note for note in made.notes)
    assert len(made.solids) == 3
    assert made.rest is None


def test_solids_that_share_a_face_keep_it() -> None:
    """The top of one is the underside of the other: without both, one of them would be open."""
    mesh = put_together(((0, 0, 0.1), (0.4, 0.4, 0.2)), ((0, 0, 0.3), (0.4, 0.4, 0.2)))
    _, lost = without_twins(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))
    assert lost == 0


def test_convex_pieces_are_found_and_others_are_not() -> None:
    ell = trimesh.boolean.union([trimesh.creation.box([1, 0.2, 0.2]), trimesh.creation.box([0.2, 1, 0.2])], "manifold")
    ball = trimesh.creation.icosphere(4, 0.3).apply_translation([3, 0, 0.3])
    parts = [*(trimesh.creation.box(size).apply_translation(middle) for middle, size in STEPS), ell, ball]
    whole = trimesh.util.concatenate(parts)
    solids, others = convex_solids(np.asarray(whole.vertices), np.asarray(whole.faces, np.int32))
    assert sorted(len(s) for s in solids)[:3] == [8, 8, 8]
    assert others.sum() == len(ell.faces)
    radii = np.linalg.norm(solids[-1] - [3, 0, 0.3], axis=1)
    assert len(solids) == 4
    assert len(radii) <= 200
    np.testing.assert_allclose(radii, 0.3, atol=1e-9)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_up_is_found_whatever_the_format(tmp_path: Path, suffix: str) -> None:
    for k, mesh in enumerate((put_together(FLOOR, *STEPS), sheet(lambda x, y: 0.1 * x))):
        for turned in (False, True):
            points = np.asarray(mesh.vertices)
            points = np.column_stack([points[:, 0], points[:, 2], -points[:, 1]]) if turned else points
            path = tmp_path / f"{k}{turned}.{suffix}"
            trimesh.Trimesh(points, mesh.faces, process=False).export(path)
            made = read_mesh(path)
            assert made.up.axis == ("y" if turned else "z")
            assert made.up.question is None
            assert turned == any("y of the file points up" in note for note in made.notes)
            np.testing.assert_allclose(
                np.ptp(made.terrain.vertices, 0), np.ptp(np.asarray(mesh.vertices), 0), atol=1e-5
            )


@pytest.mark.parametrize("turned", [False, True])
def test_a_table_without_its_top_stands_on_its_feet(tmp_path: Path, turned: bool) -> None:
    """Two ends of boards and a rail offer more to walk on when they lie on their side."""
    ends = [((x, y, 0.35), (0.05, 0.1, 0.7)) for x in (-0.65, 0.65) for y in (-0.33, 0.33)]
    rails = [((x, 0, 0.65), (0.05, 0.76, 0.1)) for x in (-0.65, 0.65)]
    mesh = put_together(*ends, *rails, *(((0, y, 0.6), (1.3, 0.03, 0.2)) for y in (-0.33, 0.33)))
    x, y, z = np.asarray(mesh.vertices).T - np.array([[0.0], [0.0], [0.3]])
    points = np.column_stack([x, z, -y] if turned else [x, y, z])
    trimesh.Trimesh(points, mesh.faces, process=False).export(tmp_path / ("a.glb" if turned else "a.stl"))
    assert read_mesh(tmp_path / ("a.glb" if turned else "a.stl")).up.axis == ("y" if turned else "z")


def test_a_thin_lip_does_not_make_the_board_behind_it_thin() -> None:
    """Balls that fall from a worktop went through the floor of a cabinet, as thick as its front edge."""
    board = trimesh.creation.box((1.0, 0.6, 0.08)).apply_translation((0, 0, 0.36))
    lip = trimesh.creation.box((0.4, 0.6, 0.01)).apply_translation((0.6, 0, 0.395))
    mesh = trimesh.boolean.union([board, lip], "manifold").subdivide_to_size(0.1)
    made = as_terrain(mesh)
    corners = made.vertices[made.triangles]
    hidden = (corners[..., 2].min(1) > 0.399) & (corners[..., 0].max(1) < 0.05)  # half of the top was not seen
    parts, _ = parts_of(sheets(Shape(replace(made, invented=hidden), 0.0), SceneConfig()))
    thick = [np.ptp(p.points[:, 2]) for p in parts if p.depth(np.array([[0.3, 0.1, 0.395]]))[0] > 0]
    assert max(thick) >= 0.039


def test_sheets_are_not_tried_where_columns_hold_a_closed_surface() -> None:
    mesh = as_terrain(put_together(*STEPS))
    fitted = fit_contact(mesh, 0.0, SceneConfig(contact_probes=100, contact_tolerance=(1e-9, 1e-9)))
    refused = {c["representation"]: c["refused"] for c in fitted.summary["considered"] if "refused" in c}
    assert "closed" in refused["sheets"]


def test_a_floor_is_the_top_of_its_slab(tmp_path: Path) -> None:
    """Low things on a slab half as thick as all, y up and about the origin, as Blender writes them."""
    slab = ((0, 0, -0.1), (7, 4, 0.2))
    mesh = put_together(slab, *(((x, 0.0, h / 2), (0.8, 0.8, h)) for x, h in ((-2, 0.1), (0, 0.15), (2, 0.2))))
    x, y, z = np.asarray(mesh.vertices).T
    trimesh.Trimesh(np.column_stack([x, z, -y]), mesh.faces, process=False).export(tmp_path / "a.obj")
    assert (read_mesh(tmp_path / "a.obj").up.axis, read_mesh(tmp_path / "a.obj").up.question) == ("y", None)


def test_a_grid_from_a_corner_at_the_origin_does_not_stand_on_y(tmp_path: Path) -> None:
    mesh = sheet(lambda x, y: 0.1 * np.sin(2 * x) * np.cos(2 * y))
    mesh.apply_translation([*-mesh.bounds[0, :2], 0])
    mesh.export(tmp_path / "a.ply")
    made = read_mesh(tmp_path / "a.ply")
    assert (made.up.axis, made.up.question) == ("z", None)


def test_treads_without_a_floor_are_found_by_what_they_offer(tmp_path: Path) -> None:
    mesh = put_together(*(((0.3 * k, 0, 0.17 * k + 0.17), (0.28, 1, 0.03)) for k in range(8)))
    x, y, z = np.asarray(mesh.vertices).T
    trimesh.Trimesh(np.column_stack([x, z, -y]), mesh.faces, process=False).export(tmp_path / "a.obj")
    assert read_mesh(tmp_path / "a.obj").up.axis == "y"


def test_a_crate_may_lie_on_any_side(tmp_path: Path) -> None:
    put_together(((0, 0, 0), (0.6, 0.7, 0.6))).export(tmp_path / "a.obj")
    made = read_mesh(tmp_path / "a.obj")
    assert made.up.axis == "z"
    assert "z was taken" in str(made.up.question)


def test_an_open_sheet_has_no_inside_to_be_turned_out(tmp_path: Path) -> None:
    """Its volume is that of nothing: a sheet with pits was taken to be inside out, and to stand on its edge."""
    sheet(lambda x, y: np.where(np.hypot(x - 0.5, y) < 0.5, -0.5, 0.2 * (x < 0))).export(tmp_path / "pits.stl")
    made = read_mesh(tmp_path / "pits.stl")
    assert made.up.axis == "z"
    assert not any("inside out" in note for note in made.notes)


def test_where_both_axes_are_plausible_it_asks_and_is_not_good(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    trimesh.creation.box([0.6, 0.5, 0.5]).apply_translation([0, 2.0, 3.0]).export(path)
    (tmp_path / "out").mkdir()
    contact = contact_mesh(path, tmp_path / "out", SceneConfig(contact_probes=200)).contact
    assert contact["verdict"]["level"] == "look"
    assert "--up z or --up y" in contact["verdict"]["reasons"][0]
    (tmp_path / "told").mkdir()
    assert contact_mesh(path, tmp_path / "told", SceneConfig(contact_probes=200), up="z").contact["question"] is None


def test_furniture_in_another_unit_is_asked_about(tmp_path: Path) -> None:
    """A crate in cm and a chair in inches are less than 50 m across; low ground of that size is no question."""
    crate, ground = put_together(((0, 0, 12.5), (40, 30, 25))), put_together(((0, 0, -0.5), (40, 30, 1)))
    (tmp_path / "out").mkdir()
    crate.export(tmp_path / "crate.stl")
    contact = contact_mesh(tmp_path / "crate.stl", tmp_path / "out", SceneConfig(contact_probes=200)).contact
    assert contact["verdict"]["level"] == "look"
    assert "25 m high (--unit m), or 0.25 m (--unit cm)" in contact["verdict"]["reasons"][0]
    assert read_mesh(tmp_path / "crate.stl", unit="cm").question is None
    ground.export(tmp_path / "ground.stl")
    assert read_mesh(tmp_path / "ground.stl").question is None


def test_geometry_that_is_not_read_is_refused_by_name(tmp_path: Path) -> None:
    """Packed, or placed by an extension: it would be zeros, or one thing of many; fans and strips would be missing."""
    exported = put_together(*STEPS).export(file_type="glb")
    size = int.from_bytes(exported[12:16], "little")
    rest, document = exported[20 + size :], json.loads(exported[20 : 20 + size])
    fans = [m | {"primitives": [p | {"mode": 6} for p in m["primitives"]]} for m in document["meshes"]]
    strips = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    strips += b"element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 1\n3 0 1 2\n"
    (tmp_path / "strips.ply").write_bytes(strips)
    for k, (change, name) in enumerate(
        (
            ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_compression"),
            ({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "EXT_mesh_gpu_instancing"),
            ({"meshes": fans}, "fans"),
            (None, "strips"),
        )
    ):
        path = tmp_path / "strips.ply"
        if change is not None:
            path = tmp_path / f"{k}.glb"
            head = json.dumps(document | change).encode()
            head += b" " * (-len(head) % 4)
            start = b"glTF" + struct.pack("<III4s", 2, 20 + len(head) + len(rest), len(head), b"JSON")
            path.write_bytes(start + head + rest)
        for read in (read_mesh, read_scan):
            with pytest.raises(RealsimError, match=name):
                read(path)


def test_what_follows_the_last_triangle_of_an_stl_is_left_out_and_said(tmp_path: Path) -> None:
    path, written = tmp_path / "a.stl", put_together(*STEPS).export(file_type="stl")
    path.write_bytes(written)
    mesh, scan = read_mesh(path), read_scan(path)
    path.write_bytes(written + b"appended by a program")
    again, scan_again = read_mesh(path), read_scan(path)
    assert np.array_equal(again.terrain.triangles, mesh.terrain.triangles)
    assert np.array_equal(scan_again.triangles, scan.triangles)
    assert all(any("21 bytes after" in note for note in notes) for notes in (again.notes, scan_again.notes))
    path.write_bytes(written + bytes(50))  # a triangle more than the header counts: which of the two is right?
    for read in (read_mesh, read_scan):
        with pytest.raises(RealsimError):
            read(path)


def test_a_hollow_of_facets_has_no_slots_between_its_parts() -> None:
    """A quarter pipe: between two planes one line of columns was left, 5 mm wide, of no plane: feet fell into it."""
    angles = np.linspace(0, 0.93 * np.pi / 2, 25)
    curve = np.column_stack([1 + 1.2 * np.sin(angles), 1.22 - 1.2 * np.cos(angles)])
    outline = [(-3.2, 0), (-3.2, curve[-1, 1]), *(curve * [-1, 1])[::-1], *curve, (3.2, curve[-1, 1]), (3.2, 0)]
    solid = Manifold.extrude(CrossSection([np.array(outline)], FillRule.NonZero), 2.0).rotate([90, 0, 0]).to_mesh64()
    mesh = mend(np.asarray(solid.vert_properties)[:, :3], np.asarray(solid.tri_verts)).terrain
    parts, _ = parts_of(boxes(Shape(mesh, 0.0), SceneConfig()))
    x = np.linspace(1.0, 2.1, 1100)
    below = np.column_stack([x, np.full(len(x), -1.0), 1.22 - np.sqrt(1.44 - (x - 1) ** 2) - 0.02])
    assert np.any([part.contains(below, 1e-6) for part in parts], axis=0).all()


def floats_over_a_platform(radius: float, rough: float) -> TerrainMesh:
    """A scan of a platform 10 cm high, and of a ball 0.8 m above it."""
    platform = trimesh.creation.box((0.6, 0.6, 0.1), trimesh.transformations.translation_matrix([0, 0, 0.05]))
    ball = trimesh.creation.icosphere(2, radius).apply_translation([0, 0, 0.9])
    ball.vertices += np.random.default_rng(0).normal(0, 1, ball.vertices.shape) * rough
    both = trimesh.util.concatenate([platform, ball])
    return replace(as_terrain(both), noise_m=0.003, resolution=0.02)


@pytest.mark.parametrize(("radius", "rough"), [(0.016, 0.003), (0.025, 0.0)])
def test_no_pillar_below_what_floats_over_a_platform(radius: float, rough: float) -> None:
    """Seen from above they lie side by side: as one island, the ball's underside went to the platform's. So it did
    where some rays missed it, and where it was narrower than the edges of a scan."""
    parts, _ = parts_of(boxes(Shape(floats_over_a_platform(radius, rough), 0.0), SceneConfig()))
    between = np.array([[x, y, z] for x in (-0.01, 0, 0.01) for y in (-0.01, 0, 0.01) for z in (0.2, 0.5, 0.8)])
    assert any(part.contains(np.array([[0, 0, 0.9]]), 1e-6).all() for part in parts)
    assert any(part.contains(np.array([[0, 0, 0.05]]), 1e-6).all() for part in parts)
    assert not any(part.contains(between, 1e-6).any() for part in parts)


def test_a_glass_of_thin_walls_stays_open() -> None:
    """Its walls of 2 mm were made one in sectors whose hulls stood 3 mm into it."""
    glass = Manifold.cylinder(0.09, 0.035, 0.035, 48) - Manifold.cylinder(0.09, 0.033, 0.033, 48).translate(
        [0, 0, 0.002]
    )
    solid = glass.to_mesh64()
    mesh = mend(np.asarray(solid.vert_properties)[:, :3], np.asarray(solid.tri_verts)).terrain
    parts, _ = parts_of(boxes(Shape(mesh, 0.0), SceneConfig()))
    turn = np.linspace(0, 2 * np.pi, 720)
    inside = np.column_stack([0.032 * np.cos(turn), 0.032 * np.sin(turn), np.full(720, 0.05)])
    assert np.any([part.contains(inside, 0.0) for part in parts], axis=0).mean() < 0.05


def test_a_large_mesh_of_thin_sheets_has_no_more_columns_than_time_allows() -> None:
    """A rack of sheet metal, 2.4 m wide, had four million: two minutes."""
    wall = trimesh.creation.box((2.4, 0.001, 0.3), trimesh.transformations.translation_matrix([0, 0, 0.15]))
    shelf = trimesh.creation.box((2.4, 0.8, 0.02), trimesh.transformations.translation_matrix([0, 0.45, 0.2]))
    rack = as_terrain(trimesh.util.concatenate([wall, wall.copy().apply_translation([0, 0.9, 0]), shelf]))
    grid = terrain(rack, 0.0).grid
    assert 0.0005 < grid.cell < 0.002
    assert grid.top[0].size < 1_100_000


def test_unused_vertices_are_no_cut_off_file(tmp_path: Path) -> None:
    mesh = put_together(*STEPS)
    rows = []
    for x, y, z in mesh.vertices:
        rows += [f"v {x} {y} {z}", f"v {x} {y} {z + 0.01}"]
    faces = [f"f {2 * a + 1} {2 * b + 1} {2 * c + 1}" for a, b, c in mesh.faces]
    (tmp_path / "a.obj").write_text("\n".join(rows + faces))
    notes = read_mesh(tmp_path / "a.obj").notes
    assert any("50% of the vertices belong to no triangle and are not used" in note for note in notes)


def test_one_triangle_and_crossing_sheets(tmp_path: Path) -> None:
    one = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.2]], [[0, 1, 2]], process=False)
    (tmp_path / "one").mkdir()
    one.export(tmp_path / "one.ply")
    contact = contact_mesh(tmp_path / "one.ply", tmp_path / "one", SceneConfig(contact_probes=200)).contact
    assert contact["p95_mm"] < 5
    crossing = trimesh.util.concatenate([sheet(lambda x, y: 0.2 * x, 2, 10), sheet(lambda x, y: -0.2 * x, 2, 10)])
    assert ground_level(as_terrain(crossing)).z <= -0.19


def test_triangulated_points_with_slivers_on_their_rim_make_a_good_height_field(tmp_path: Path) -> None:
    """Upright slivers look like walls with nothing behind, which no height field has and which no sheet carries."""
    rng = np.random.default_rng(4)
    place = np.vstack([rng.uniform(-1.5, 1.5, (2500, 2)), [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]]])
    x, y = place.T
    height = 0.2 * np.sin(2 * x) * np.cos(1.5 * y) + 0.2 * (x > 0.5)
    trimesh.Trimesh(np.column_stack([place, height]), Delaunay(place).simplices, process=False).export(
        tmp_path / "a.ply"
    )
    (tmp_path / "out").mkdir()
    config = SceneConfig(contact="hfield", contact_probes=400)
    contact = contact_mesh(tmp_path / "a.ply", tmp_path / "out", config).contact
    assert any("upright slivers" in note for note in contact["mended"])
    assert contact["verdict"]["level"] == "good"


def test_steps_that_reach_the_rim_are_no_slivers() -> None:
    """A surface that is a function of x and y, with risers that run 1 mm: they lie in the rim with their short side."""
    x = np.array([0.0, 0.3, 0.301, 0.6, 0.601, 0.9])
    place = np.array([[a, b] for a in x for b in (0.0, 1.0)])
    height = np.repeat([0.0, 0.0, 0.15, 0.15, 0.3, 0.3], 2)
    k = 2 * np.arange(5)
    faces = np.concatenate([np.stack([k, k + 2, k + 3], 1), np.stack([k, k + 3, k + 1], 1)])
    made = mend(np.column_stack([place, height]), faces)
    assert len(made.terrain.triangles) == len(faces)


def test_thin_posts_and_low_sills_of_a_model_are_no_specks() -> None:
    """Of a solid that is no scan: a post of 1.5 cm, and a sill of 8 mm, which is lower than the noise of one."""
    cylinder = trimesh.creation.cylinder(0.0075, 0.8, sections=16).apply_translation([0.2, 0.2, 0.4])
    parts = [
        put_together(((0, 0, -0.05), (2, 2, 0.1))),
        cylinder,
        put_together(((0, -0.2, 0), (0.04, 1.0, 0.016)), ((0.03, -0.2, 0), (0.04, 0.2, 0.016))),
    ]
    mesh = trimesh.boolean.union([*parts[:2], *parts[2].split()], engine="manifold")
    made = mend(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    touch = SimTouch(spec_of(boxes(Shape(made.terrain, 0.0), SceneConfig())), BALL, batch=2)
    post, sill = touch.clearance(np.array([[0.2, 0.2, 0.5], [0.0, -0.2, 0.01]]), np.tile([1.0, 0, 0, 0], (2, 1)))
    assert post < 0
    assert sill < -0.005


@pytest.mark.parametrize("kind", ["boxes and boards", "scan"])
def test_what_has_flat_faces_is_no_scan(kind: str) -> None:
    """Its small faces are not noise, though it is open."""
    mesh = closet()
    if kind == "boxes and boards":
        parts = put_together(*STEPS, *(((0.4 * k, 0.9, 0.1), (0.3, 0.2, 0.2)) for k in range(6)))
        parts.update_faces(np.arange(len(parts.faces)) > 1)
        mesh = as_terrain(parts)
    assert is_exact(mesh) == (kind != "scan")
