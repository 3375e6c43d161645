"""Any mesh from anywhere: mended with a note, or refused with a message."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from realsim.core.errors import ExportError
from realsim.export import contact_mesh
from realsim.export.config import SceneConfig
from realsim.export.ground import ground_level
from realsim.export.mend import mend, read_mesh
from realsim.export.unite import united
from realsim.export.winding import turn_stray
from tests.truths.solids import block, grid_mesh, terrain, with_floor

CONFIG = SceneConfig(contact_probes=200)


def stl(path: Path, scale: float = 1.0, *, flipped: bool = False) -> Path:
    mesh = terrain("stairs")
    faces = mesh.triangles[:, ::-1] if flipped else mesh.triangles
    trimesh.Trimesh(mesh.vertices * scale, faces, process=False).export(path)
    return path


def test_millimetres_are_refused_unless_said(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl", 1000)
    with pytest.raises(ExportError, match="--unit mm"):
        read_mesh(path)
    mesh = read_mesh(path, "mm").terrain
    assert np.ptp(mesh.vertices, 0).max() < 10


def test_a_micrometre_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="terrain's size"):
        read_mesh(stl(tmp_path / "a.stl", 1e-6))


def test_a_vast_mesh_is_refused_unless_its_unit_is_said(tmp_path: Path) -> None:
    """67 mm in millimetres are 67 m in metres: larger than what a robot is taken across, and nobody said so."""
    path = stl(tmp_path / "a.stl", 20)
    with pytest.raises(ExportError, match=r"--unit mm makes it 0\.0672 m.*--unit m if it is that large"):
        read_mesh(path)
    assert np.ptp(read_mesh(path, "m").terrain.vertices, 0).max() > 50


def test_no_unit_makes_an_enormous_mesh_fit(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"cut out the part|lost their precision"):
        read_mesh(stl(tmp_path / "a.stl", 1e6))


def test_an_stl_that_was_cut_off_is_no_point_cloud(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl")
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(ExportError, match="cut off"):
        read_mesh(path)


def test_more_triangles_than_memory_holds_are_refused_with_a_way_out(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(sys.modules["realsim.export.mend"], "MAX_TRIANGLES", 50)
    with pytest.raises(ExportError, match="too many triangles") as refused:
        read_mesh(stl(tmp_path / "a.stl"))
    assert "at most 50" in str(refused.value)
    assert "decimate" in str(refused.value)


def test_triangles_on_one_line_are_no_mesh() -> None:
    with pytest.raises(ExportError, match="1 triangles, all without area"):
        mend(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]]))


def test_triangles_that_face_the_wrong_way_are_turned() -> None:
    """Some of a block, and all of another: the solids are those of the mesh as it was."""
    mesh = with_floor(block(0, 0, 0.4, 0.2, 0.2) + block(1, 0, 0.2, 0.2, 0.3))
    wrong = mesh.triangles.copy()
    first = mesh.vertices[wrong][:, :, 0].max(1) < 0.3
    second = (mesh.vertices[wrong][:, :, 0].min(1) > 0.8) & (np.abs(mesh.vertices[wrong][:, :, 1]).max(1) < 0.2)
    assert first.sum() == second.sum() == 12
    for turned in (np.flatnonzero(first)[:3], second):
        wrong[turned] = wrong[turned, ::-1]
    made = mend(mesh.vertices, wrong)
    mended, notes = made.terrain, made.notes
    assert any("3 triangles that faced the other way" in n for n in notes)
    assert any("1 closed pieces were inside out" in n for n in notes)
    corners, right = mended.vertices[mended.triangles], mesh.vertices[mesh.triangles]
    np.testing.assert_allclose(normals(corners), normals(right), atol=1e-12)


def normals(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def test_a_strip_with_one_side_is_left_alone() -> None:
    """A Moebius strip cannot face one way."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    along = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(24)])
    across = 0.2 * np.column_stack([np.cos(turn / 2) * along[:, 0], np.cos(turn / 2) * along[:, 1], np.sin(turn / 2)])
    vertices = np.concatenate([along + across, along - across])
    k, n = np.arange(24), np.arange(1, 25)
    a, b, c, d = k, k + 24, np.r_[n[:-1], 24], np.r_[n[:-1] + 24, 0]  # the last pair is joined crosswise
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.int32)
    out, turned = turn_stray(vertices, faces)
    assert turned == 0
    np.testing.assert_array_equal(out, faces)


def test_inside_out_is_turned_round(tmp_path: Path) -> None:
    found = read_mesh(stl(tmp_path / "a.stl", flipped=True))
    mesh = found.terrain
    assert any("inside out" in n for n in found.notes)
    right = read_mesh(stl(tmp_path / "b.stl")).terrain
    assert ground_level(mesh).z == pytest.approx(ground_level(right).z) == pytest.approx(0.0, abs=1e-6)


def test_nan_and_flat_triangles_are_taken_out() -> None:
    mesh = terrain("stairs")
    vertices = np.concatenate([mesh.vertices, [[np.nan, 0, 0]]])
    bad = np.array([[0, 1, len(vertices) - 1], [0, 0, 1], [0, 1, 10**6]])
    made = mend(vertices, np.concatenate([mesh.triangles, bad]))
    mended, notes = made.terrain, made.notes
    assert len(mended.triangles) == len(mesh.triangles)
    assert np.isfinite(mended.vertices).all()
    assert any("2 triangles" in n for n in notes)
    assert any("1 triangles without area" in n for n in notes)


def test_open_and_non_manifold_are_said() -> None:
    mesh = terrain("stairs")
    fin = np.array([[*mesh.triangles[0, :2], len(mesh.vertices)]])
    vertices = np.vstack([mesh.vertices, mesh.vertices.max(0)])
    notes = mend(vertices, np.concatenate([mesh.triangles, fin])).notes
    assert any("not manifold" in n for n in notes)
    assert any("open" in n for n in notes)


def test_solids_that_share_an_edge_are_not_open() -> None:
    parts = [trimesh.creation.box([0.3, 1, h]).apply_translation([0.3 * i, 0, h / 2]) for i, h in enumerate((0.2, 0.4))]
    both = trimesh.util.concatenate(parts)
    notes = mend(np.asarray(both.vertices), np.asarray(both.faces)).notes
    assert not any("open" in n for n in notes)


def test_a_file_that_lost_its_last_triangles_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    mesh = terrain("stairs")
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(path)
    assert not any("cut off" in n for n in read_mesh(path).notes)
    lines = path.read_text().splitlines(keepends=True)
    faces = [i for i, line in enumerate(lines) if line.startswith("f ")]
    path.write_text("".join(lines[: faces[len(faces) // 2]]))
    assert any("cut off" in n for n in read_mesh(path).notes)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", b"\x00garbage" * 9])
def test_empty_and_broken_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    with pytest.raises(ExportError):
        read_mesh(path)


def test_all_nan() -> None:
    with pytest.raises(ExportError, match="no usable triangles"):
        mend(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))


def test_other_suffixes_and_units_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.blend"
    path.write_bytes(b"x")
    with pytest.raises(ExportError, match="not a mesh file"):
        read_mesh(path)
    with pytest.raises(ExportError, match="unknown unit"):
        read_mesh(path, "furlong")
    with pytest.raises(ExportError, match="not there"):
        read_mesh(tmp_path / "a.gltf")
    path = path.rename(tmp_path / "a.gltf")
    with pytest.raises(ExportError, match="not a mesh file") as refused:
        read_mesh(path)
    assert "as .glb" in refused.value.render()


def test_solids_on_a_floor_do_not_overlap() -> None:
    box = block(0, 0, 0.4, 0.4, 0.2, 0.0).to_mesh64()
    slab = block(0, 0, 2, 2, 0.0, -0.1).to_mesh64()
    vertices = np.concatenate([np.asarray(m.vert_properties)[:, :3] for m in (box, slab)])
    faces = np.concatenate([np.asarray(box.tri_verts), np.asarray(slab.tri_verts) + len(box.vert_properties)])
    notes = mend(vertices, faces.astype(np.int32)).notes
    assert not any("overlap" in note for note in notes)


def test_a_wall_alone_is_refused() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1.0]])
    with pytest.raises(ExportError, match="to stand on"):
        mend(vertices, np.array([[0, 1, 2], [1, 3, 2]]))


def test_glb_stands_up_again(tmp_path: Path) -> None:
    mesh = terrain("stairs")
    upright = np.column_stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]])
    trimesh.Trimesh(upright, mesh.triangles, process=False).export(tmp_path / "a.glb")
    found = read_mesh(tmp_path / "a.glb")
    notes = found.notes
    np.testing.assert_allclose(found.terrain.vertices.max(0), mesh.vertices.max(0), atol=1e-5)
    assert notes[0].startswith("y of the file")


def test_a_self_intersecting_mesh_is_one_solid(tmp_path: Path) -> None:
    """Two boxes through each other, not united: the measure agrees with the contact."""
    one, two = with_floor(block(0, 0, 0.4, 0.2, 0.2)), block(0.1, 0.05, 0.2, 0.4, 0.3).to_mesh64()
    offset = len(one.vertices)
    vertices = np.concatenate([one.vertices, np.asarray(two.vert_properties)[:, :3]])
    faces = np.concatenate([one.triangles, np.asarray(two.tri_verts, np.int32) + offset])
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "a.ply")
    out = tmp_path / "out"
    out.mkdir()
    files = contact_mesh(tmp_path / "a.ply", out, CONFIG)
    assert any("overlap" in note for note in files.contact["mended"])
    assert files.contact["p95_mm"] < 10
    assert files.contact["leaks"] == 0
    assert {"scene.xml", "contact.json", "contact.png", "mesh.ply"} <= {p.name for p in out.iterdir()}


@pytest.mark.parametrize("many", [10, 700], ids=["solids", "sheet"])
def test_a_mesh_of_millions_of_triangles_is_looked_at_as_a_small_one_is(tmp_path: Path, monkeypatch, many: int) -> None:
    """Of so many, the rays from above are cast at those that they meet, and an open surface is mirrored on some."""
    vertices, faces = grid_mesh(lambda x, y: 0.2 * np.sin(3 * x) * np.cos(2 * y), 3.0, 40)
    if many == 10:
        blocks = [block(0, 0, 0.4, 0.2, 0.2).to_mesh64(), block(0.1, 0.05, 0.2, 0.4, 0.3).to_mesh64()]
        vertices = np.concatenate([np.asarray(b.vert_properties)[:, :3] for b in blocks])
        faces = np.concatenate([np.asarray(b.tri_verts, np.int64) + 8 * k for k, b in enumerate(blocks)])
    trimesh.Trimesh(vertices, faces[:, ::-1], process=False).export(tmp_path / "a.ply")
    small = read_mesh(tmp_path / "a.ply")
    for module in ("realsim.core.meshes", "realsim.export.mend", "realsim.export.up"):
        monkeypatch.setattr(sys.modules[module], "AT_ONCE", many)
    large = read_mesh(tmp_path / "a.ply")
    assert (large.up, large.notes) == (small.up, small.notes)
    np.testing.assert_array_equal(large.terrain.vertices, small.terrain.vertices)
    np.testing.assert_array_equal(large.terrain.triangles, small.terrain.triangles)


def test_an_open_piece_is_not_made_one_with_solids() -> None:
    """Of a few triangles that close nothing, the library for solids ended the process."""
    turn = np.linspace(0, np.pi, 10)
    points = np.column_stack([np.cos(turn), np.sin(turn), 0.1 * turn])
    faces = np.column_stack([np.zeros(9, int), np.arange(1, 10), np.arange(2, 11)]).astype(np.int32)
    assert united(np.vstack([np.zeros((1, 3)), points]), faces)[2] == 0


def test_what_lies_inside_another_solid_is_no_surface() -> None:
    """A ridge of blocks leaning into each other: rays that start inside one of them had met the next from its front."""
    blocks = [block(0.1 * k, 0, 0.2, 0.3, 0.2 + 0.02 * k).to_mesh64() for k in range(4)]
    parts = [with_floor(block(2, 0, 0.1, 0.1, 0.1))]
    vertices = [parts[0].vertices, *(np.asarray(b.vert_properties)[:, :3] for b in blocks)]
    starts = np.cumsum([0, *(len(v) for v in vertices)])
    faces = [parts[0].triangles, *(np.asarray(b.tri_verts, np.int32) for b in blocks)]
    made = mend(np.vstack(vertices), np.vstack([f + s for f, s in zip(faces, starts, strict=False)]))
    mended, notes = made.terrain, made.notes
    assert any("5 closed pieces were made one" in note for note in notes)
    whole = block(0, 0, 0.2, 0.3, 0.2)
    for k in range(1, 4):
        whole += block(0.1 * k, 0, 0.2, 0.3, 0.2 + 0.02 * k)
    near = mended.vertices[mended.triangles]
    near = near[(near[:, :, 0].max(1) < 1) & (near[:, :, 0].min(1) > -0.2)]
    assert np.linalg.norm(normals(near), axis=1).sum() / 2 == pytest.approx(whole.surface_area(), rel=1e-6)
