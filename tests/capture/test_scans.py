"""Finished surfaces as sources: every format gives back what was written, and its unit is looked at."""

import json
import shutil
import struct
import sys

import numpy as np
import pytest
import trimesh

from realsim.capture import CaptureConfig, inspect, read
from realsim.capture import scanfile as scanfile_module
from realsim.core.errors import CaptureError, MissingExtraError, RealsimError
from realsim.core.types import Scan

from .damage import cut
from .scene import walk
from .writers import write_pcd, write_polycam

CONFIG = CaptureConfig()


def terrain() -> trimesh.Trimesh:
    """A floor of 3 m x 2 m with two blocks, vertices coloured."""
    floor = trimesh.creation.box((3, 2, 0.1))
    blocks = [trimesh.creation.box((0.5, 0.6, 0.3)).apply_translation([x, 0, 0.2]) for x in (-1, 1)]
    mesh = trimesh.util.concatenate([floor, *blocks])
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3), dtype=np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh


def scan_of(path, config=CONFIG) -> Scan:
    scan = read(path, config)
    assert isinstance(scan, Scan)
    assert scan.layout == "scan"
    assert np.isfinite(scan.points).all()
    return scan


def corners(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(K, 9) corners of triangles in an order that does not depend on how they are numbered."""
    rolled = [np.roll(points[triangles], k, axis=1).reshape(len(triangles), 9).round(5) for k in range(3)]
    first = np.array([min(map(tuple, rows)) for rows in zip(*rolled, strict=True)])
    return first[np.lexsort(first.T)]


def test_triangles_without_area_are_said(tmp_path):
    """What a disk has overwritten with zeros."""
    file = tmp_path / "a.stl"
    terrain().export(file)
    assert not any("no area" in said for said in scan_of(file).assumptions)
    data = bytearray(file.read_bytes())
    data[84 + 50 * 3 : 84 + 50 * 6] = bytes(150)
    file.write_bytes(data)
    assert any(said.startswith("3 of") and "no area" in said for said in scan_of(file).assumptions)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_meshes_round_trip(suffix, tmp_path):
    mesh = terrain()
    mesh.export(tmp_path / f"terrain.{suffix}")
    scan = scan_of(tmp_path / f"terrain.{suffix}")
    assert scan.triangles is not None
    np.testing.assert_allclose(
        corners(scan.points, scan.triangles), corners(np.asarray(mesh.vertices), np.asarray(mesh.faces)), atol=2e-5
    )
    if suffix == "stl":
        assert len(scan.points) == len(mesh.vertices), "equal corners are joined"
        assert scan.colors is None
    else:
        np.testing.assert_array_equal(scan.colors, mesh.visual.vertex_colors[:, :3])
    assert (scan.up_world is None) == (suffix != "glb")
    assert scan_of(tmp_path).points.shape == scan.points.shape, "a folder that holds one scan is that scan"


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_clouds_round_trip(suffix, tmp_path):
    rng = np.random.default_rng(1)
    points = rng.uniform([0, 0, 0], [3, 2, 0.3], (500, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (500, 3), dtype=np.uint8)
    path = tmp_path / f"cloud.{suffix}"
    if suffix == "pcd":
        write_pcd(path, points[None], colors[None])
    else:
        trimesh.PointCloud(points, colors=colors).export(path)
    scan = scan_of(path)
    assert scan.triangles is None
    np.testing.assert_allclose(scan.points, points, atol=1e-6)
    np.testing.assert_array_equal(scan.colors, colors)


def test_ply_normals_are_kept(tmp_path):
    points = np.random.default_rng(1).uniform(0, 2, (50, 3))
    normals = np.tile([0.0, 0.6, 0.8], (50, 1))
    lines = [" ".join(map(str, row)) for row in np.hstack([points, 2 * normals])]
    names = ("x", "y", "z", "nx", "ny", "nz")
    head = ["ply", "format ascii 1.0", "element vertex 50", *(f"property float {n}" for n in names), "end_header"]
    (tmp_path / "a.ply").write_text("\n".join([*head, *lines]) + "\n")
    np.testing.assert_allclose(scan_of(tmp_path / "a.ply").normals, normals, atol=1e-6)


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("deep", [True, False])
def test_las(suffix, deep, tmp_path):
    laspy = pytest.importorskip("laspy", reason="extra lidar is not installed")
    corner = np.array([500_000.0, 4_100_000, 120])
    points = np.random.default_rng(2).uniform(corner, corner + np.array([3, 2, 0.3]), (400, 3))
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = [1e-4] * 3, [500_000, 4_100_000, 100]
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.red, las.green, las.blue = np.full((3, 400), 200) * (256 if deep else 1)
    las.write(tmp_path / f"a.{suffix}")
    scan = scan_of(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(scan.points, points - corner, atol=2e-4)
    assert any("add (500000, 4100000, 120) m" in note for note in scan.assumptions)
    assert scan.colors is not None
    assert (scan.colors == 200).all()
    np.testing.assert_array_equal(scan.up_world, [0, 0, 1])


def test_las_names_the_extra(tmp_path, monkeypatch):
    (tmp_path / "a.las").write_bytes(b"LASF")
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingExtraError, match=r"\[lidar\]"):
        read(tmp_path / "a.las", CONFIG)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000), ("cm", 100), ("inch", 1 / 0.0254)])
def test_units(unit, factor, tmp_path):
    mesh = terrain()
    mesh.apply_scale(factor)
    mesh.export(tmp_path / "a.stl")
    scan = scan_of(tmp_path / "a.stl", CaptureConfig(unit=unit))
    np.testing.assert_allclose(np.ptp(scan.points, axis=0), [3, 2, 0.4], atol=1e-4)
    assert any(f"in {unit}, as requested" in a for a in scan.assumptions)


def test_millimetres_are_noticed(tmp_path):
    mesh = terrain()
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "a.stl")
    with pytest.raises(CaptureError, match="implausible size") as caught:
        read(tmp_path / "a.stl", CONFIG)
    assert "--unit mm" in str(caught.value.hint)
    terrain().export(tmp_path / "b.stl")
    with pytest.raises(CaptureError, match="implausible size") as caught:
        read(tmp_path / "b.stl", CaptureConfig(unit="mm"))
    assert "--unit m" in str(caught.value.hint)


def test_an_unusual_size_is_said(tmp_path):
    mesh = terrain()
    mesh.apply_scale(20)
    mesh.export(tmp_path / "a.obj")
    assert any("unusual" in w for w in scan_of(tmp_path / "a.obj").warnings)


def test_gltf_scenes_are_flattened_and_textures_said(tmp_path):
    from PIL import Image

    box = trimesh.creation.box((1, 1, 1))
    picture = Image.fromarray(np.zeros((4, 4, 3), np.uint8))
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), image=picture)
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([3, 0, 0]))
    # A mirrored copy must still have its outside outside.
    scene.add_geometry(box, transform=np.diag([-1.0, 1, 1, 1]))
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    scan = scan_of(tmp_path / "a.glb")
    assert scan.triangles is not None
    np.testing.assert_allclose(scan.points.min(0), [-0.5, -0.5, -0.5])
    np.testing.assert_allclose(scan.points.max(0), [3.5, 0.5, 0.5])
    a, b, c = (scan.points[scan.triangles[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(2.0), "both cubes have positive volume"
    assert scan.colors is None
    assert "textures are not read" in scan.assumptions
    assert any("2 meshes" in a for a in scan.assumptions)


def test_a_picture_that_a_ply_names_is_not_looked_for(tmp_path, caplog):
    terrain().export(tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes().replace(b"element vertex", b"comment TextureFile a.jpg\nelement vertex", 1)
    (tmp_path / "a.ply").write_bytes(data)
    assert scan_of(tmp_path / "a.ply").triangles is not None
    assert not caplog.records


def test_points_that_are_nan_are_left_out_but_vertices_are_refused(tmp_path):
    text = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv nan 1 0\n"
    (tmp_path / "cloud.obj").write_text(text)
    assert any("1 of 4 points are NaN" in w for w in scan_of(tmp_path / "cloud.obj").warnings)
    (tmp_path / "mesh.obj").write_text(text + "f 1 2 3\nf 1 3 4\n")
    with pytest.raises(CaptureError, match="no places") as caught:
        scan_of(tmp_path / "mesh.obj")
    assert caught.value.expected is not None
    assert caught.value.expected.startswith("4 vertices")


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.obj", b""),
        ("a.obj", b"# nothing\n"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("a.obj", b"v nan nan nan\nv nan 0 0\nv nan 1 0\nf 1 2 3\n"),
        ("a.stl", b""),
        ("a.stl", b"solid x\nendsolid x\n"),
        ("a.stl", b"\0" * 84),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"),
        ("a.ply", b"<html>404</html>"),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nend_header\n"),
        ("a.glb", b"glTF" + b"\0" * 40),
        ("a.glb", b"{}"),
        ("a.las", b"LASF" + b"\0" * 400),
        ("a.laz", b"x"),
        ("a.pcd", b"VERSION .7\n"),
    ],
)
def test_what_is_no_scan_is_an_error_that_names_the_file(name, data, tmp_path):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RealsimError) as caught:
        read(tmp_path / name, CONFIG)
    assert name in str(caught.value)


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "obj"])
def test_truncated_scans_never_end_in_anything_but_a_message(suffix, tmp_path):
    for share in (0.02, 0.3, 0.6, 0.95):
        path = tmp_path / f"a{share}.{suffix}"
        terrain().export(path)
        cut(path, share)
        try:
            scan = scan_of(path)
        except RealsimError:
            continue
        assert suffix == "obj", "text that ends early can still be a mesh"
        assert share > 0.9 or any("cut off" in w for w in scan.warnings)


def test_a_ply_as_text_that_ends_early_is_refused(tmp_path):
    data = terrain().export(file_type="ply", encoding="ascii")
    (tmp_path / "a.ply").write_bytes(data)
    scan_of(tmp_path / "a.ply")
    for share in (0.3, 0.8, 0.99):
        (tmp_path / "a.ply").write_bytes(data[: int(share * len(data))])
        with pytest.raises(RealsimError, match="truncated"):
            read(tmp_path / "a.ply", CONFIG)


def test_enormous_scans_are_refused_by_their_header(tmp_path, monkeypatch):
    (tmp_path / "a.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 9000000000\nproperty float x\nend_header\n"
    )
    with pytest.raises(CaptureError, match="too large") as caught:
        read(tmp_path / "a.ply", CONFIG)
    assert "thin it out" in str(caught.value)
    (tmp_path / "b.stl").write_bytes(bytes(80) + struct.pack("<I", 4) + bytes(200))
    monkeypatch.setattr(scanfile_module, "MAX_VERTICES", 10)
    with pytest.raises(CaptureError, match="too large"):
        read(tmp_path / "b.stl", CONFIG)


def test_several_scans_in_a_folder_are_not_guessed(tmp_path):
    terrain().export(tmp_path / "a.stl")
    terrain().export(tmp_path / "b.ply")
    with pytest.raises(CaptureError, match=r"name one: a.stl, b.ply"):
        read(tmp_path, CONFIG)


def test_the_mesh_in_a_broken_capture_is_not_taken_for_it(tmp_path):
    write_polycam(tmp_path, walk(3))
    terrain().export(tmp_path / "raw.glb")
    shutil.rmtree(tmp_path / "keyframes/depth")
    with pytest.raises(CaptureError, match="colour without depth") as caught:
        read(tmp_path, CONFIG)
    assert "--layout scan reads raw.glb" in str(caught.value.hint)
    assert scan_of(tmp_path, CaptureConfig(layout="scan")).triangles is not None


def test_a_folder_with_one_unorganised_cloud_is_a_scan(tmp_path):
    write_pcd(tmp_path / "a.pcd", np.random.default_rng(0).uniform(0, 2, (1, 200, 3)))
    assert len(scan_of(tmp_path).points) == 200


def test_obj_does_not_open_other_files(tmp_path):
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside/a.obj").write_text(
        "mtllib ../secret.mtl\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nusemtl a\nf 1 2 3 4\n"
    )
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd ../../etc/passwd\n")
    assert len(scan_of(tmp_path / "inside/a.obj").points) == 4


def test_inspection_of_a_scan(tmp_path):
    terrain().export(tmp_path / "a.stl")
    found = inspect(tmp_path / "a.stl", CONFIG)
    assert found.frames["triangles"] == 36
    assert found.frames["extent_m"] == [3.0, 2.0, 0.4]
    json.dumps(found.as_dict())
    assert "a mesh in m" in found.render()


def test_room_lidar(shared):
    scan = scan_of(shared("real_captures/pcl_room_lidar/tutorials/room_scan1.pcd"))
    assert scan.points.shape == (112586, 3)
    assert np.ptp(scan.points, axis=0) == pytest.approx([29.25, 14.47, 3.06], abs=0.01)


def test_triangles_that_name_a_vertex_twice_are_counted(tmp_path):
    box = trimesh.creation.box((3, 2, 0.3))
    faces = box.faces.copy()
    faces[[2, 5], 1] = faces[[2, 5], 0]
    trimesh.Trimesh(box.vertices, faces, process=False).export(tmp_path / "terrain.ply")
    assert any("2 triangles name a vertex twice" in a for a in read(tmp_path, CaptureConfig()).assumptions)


def test_a_face_that_cannot_be_read_and_a_vertex_far_from_all_others_are_said(tmp_path):
    path = tmp_path / "terrain.obj"
    trimesh.creation.box((3, 2, 0.3)).subdivide().export(path)
    assert not read(tmp_path, CaptureConfig()).warnings
    text = path.read_text()
    face = next(line for line in text.splitlines() if line.startswith("f "))
    path.write_text(text.replace(face, face.rpartition(" ")[0]))
    assert any("1 of 48 faces could not be read" in w for w in read(tmp_path, CaptureConfig()).warnings)
    vertex = next(line for line in text.splitlines() if line.startswith("v "))
    path.write_text(text.replace(vertex, "v 9 0 0"))
    assert any("a single vertex at 9, 0, 0" in w for w in read(tmp_path, CaptureConfig()).warnings)


def test_a_wild_point_of_a_cloud_is_said(tmp_path):
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0, 0], [3, 2, 0.1], (5000, 3))
    for name, wild in (("near", 2.9), ("far", 1.7e13)):
        points[7, 0] = wild
        trimesh.PointCloud(points).export(tmp_path / f"{name}.ply")
    assert not read(tmp_path / "near.ply", CaptureConfig()).warnings
    assert any("a single vertex at 1.7e+13" in w for w in read(tmp_path / "far.ply", CaptureConfig()).warnings)


@pytest.mark.parametrize("corner", [(3, 0, 0), (1, 1, 0)])
def test_a_mesh_of_one_triangle_or_without_area_is_refused(corner, tmp_path):
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], corner], [[0, 1, 2]], process=False).export(tmp_path / "a.ply")
    with pytest.raises(CaptureError, match="no surface to stand on"):
        scan_of(tmp_path / "a.ply")


def test_a_cloud_of_another_format_is_to_be_exported(tmp_path):
    (tmp_path / "a.xyz").write_text("0 0 0\n1 0 0\n")
    with pytest.raises(CaptureError) as caught:
        scan_of(tmp_path / "a.xyz")
    assert ".ply, .pcd or .las" in str(caught.value.hint)
