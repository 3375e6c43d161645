"""A scene on disk holds what stands on it, and nothing in it depends on where or when it was written."""

import errno
import io
import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from realsim.core.errors import ExportError, RealsimError, UnknownNameError
from realsim.core.files import output_folder
from realsim.core.meshes import compact, vertex_normals
from realsim.core.types import TerrainMesh
from realsim.export import CONTACT, write_scene
from realsim.export.config import SceneConfig
from realsim.export.contact.hfield import hfield
from realsim.export.contact.shape import Shape
from realsim.export.heights import HeightGrid
from realsim.export.visual import bake

from .terrain import GROUND, box, platform, scene, terrain_mesh, two_platforms


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("scene")
    aligned, mesh = two_platforms()
    return write_scene(folder, aligned, mesh, SceneConfig(contact_probes=200)), mesh


def lowered_ball(scene_xml: Path, x: float, y: float, radius: float = 0.01) -> float:
    """z of the lowest point of a ball that is lowered at x y until it first touches."""
    spec = mujoco.MjSpec.from_file(str(scene_xml))
    body = spec.worldbody.add_body(name="probe")
    body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius] * 3, pos=[x, y, 0])
    model = spec.compile()
    data = mujoco.MjData(model)

    def touches(z: float) -> bool:
        data.qpos[0] = z
        mujoco.mj_forward(model, data)
        return data.ncon > 0

    # March first: a ball deep inside a thin solid is through it, so touching is not monotone in z.
    free = next(z for z in np.arange(1.0, -2.0, -radius / 2) if touches(z - radius / 2))
    touching = free - radius / 2
    while free - touching > 1e-5:
        middle = (free + touching) / 2
        free, touching = (free, middle) if touches(middle) else (middle, touching)
    return free - radius


def test_checks_hold_every_platform(written) -> None:
    files, _ = written
    drops = files.checks["drops"]
    assert {(d["platform"], d["object"]) for d in drops} == {
        (p, o) for p in ("start", "goal") for o in ("sphere", "box")
    }
    assert max(abs(d["error_m"]) for d in drops) < 0.003


@pytest.mark.parametrize(("x", "y", "z"), [(0.1, 0.2, 0), (2, -0.1, 0.05), (1, 0.1, -0.2), (1, -0.3, GROUND)])
def test_heights_by_contact(written, x: float, y: float, z: float) -> None:
    assert lowered_ball(written[0].scene_xml, x, y) == pytest.approx(z, abs=0.001)


def test_floor_goes_on_outside_the_scan(written) -> None:
    assert lowered_ball(written[0].scene_xml, -3, 4) == pytest.approx(GROUND, abs=1e-4)


def test_heights_by_ray(written) -> None:
    """Nodes of the compiled height field lie on the mesh to well below a millimetre."""
    files, _ = written
    model = mujoco.MjModel.from_xml_path(str(files.scene_xml))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    only_collision = np.array([0, 0, 0, 1, 0, 0], np.uint8)
    hit = np.zeros(1, np.int32)
    for x, y, z in [(0.0, 0.0, 0.0), (0.13, -0.2, 0.0), (1.9, 0.2, 0.05), (1.05, 0.1, -0.2)]:
        distance = mujoco.mj_ray(model, data, np.array([x, y, 1.0]), np.array([0, 0, -1.0]), only_collision, 1, -1, hit)
        assert 1 - distance == pytest.approx(z, abs=1e-4)


def test_mesh_files_hold_what_was_seen(written) -> None:
    files, mesh = written
    for path in (files.mesh_ply, files.mesh_glb):
        loaded = trimesh.load(path, process=False)
        whole = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
        assert len(whole.faces) == len(mesh.seen)
    ply = trimesh.load(files.mesh_ply, process=False)
    vertices, _, colors = compact(mesh.vertices, mesh.seen, mesh.colors)
    np.testing.assert_allclose(ply.vertices, vertices, atol=1e-6)
    np.testing.assert_array_equal(ply.visual.vertex_colors[:, :3], colors)


def test_glb_stands_upright(written) -> None:
    """glTF's y is up: heights are y, and the frame stays right-handed."""
    files, mesh = written
    glb = trimesh.load(files.mesh_glb, process=False).to_geometry()
    vertices, _ = compact(mesh.vertices, mesh.seen)
    np.testing.assert_allclose(glb.vertices, np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], 1), atol=1e-5)


def test_files_are_relative_and_there(written) -> None:
    files, _ = written
    for element in ET.parse(files.scene_xml).iter():
        name = element.get("file")
        if name:
            assert not os.path.isabs(name)
            assert (files.folder / name).is_file()


@pytest.fixture(scope="module")
def with_g1(tmp_path_factory: pytest.TempPathFactory):
    return write_scene(tmp_path_factory.mktemp("g1"), *two_platforms(), SceneConfig(robot="g1", contact_probes=200))


def test_a_rerun_writes_the_same_bytes(with_g1, tmp_path: Path) -> None:
    write_scene(tmp_path, *two_platforms(), SceneConfig(robot="g1", contact_probes=200))
    one, two = ({p.name: p.read_bytes() for p in sorted(f.iterdir())} for f in (with_g1.folder, tmp_path))
    assert one == two


def test_g1_stands_on_the_start_platform(with_g1) -> None:
    files = with_g1
    assert files.checks["robot_moved_m"] < 0.05
    model = mujoco.MjModel.from_xml_path(str(files.scene_xml))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    soles = np.array([data.site("left_foot").xpos, data.site("right_foot").xpos])
    np.testing.assert_allclose(soles[:, 2], 0, atol=0.005)
    assert soles[0, 1] > 0 > soles[1, 1]  # left foot on the left when facing +x


def test_a_scene_without_colours_or_platforms(tmp_path: Path) -> None:
    mesh = terrain_mesh([box(0, 0, 0.5, 0.5, 0)], colors=False)
    files = write_scene(tmp_path, scene(mesh, ()), mesh, SceneConfig(contact_probes=200))
    assert files.checks["drops"] == []
    assert not (tmp_path / "visual.png").exists()


def test_a_platform_that_is_not_there_is_a_finding(tmp_path: Path) -> None:
    """Nothing is held 20 cm above the floor: the scene is written, and its check says by how much."""
    aligned, mesh = two_platforms()
    wrong = replace(aligned, platforms=(*aligned.platforms, platform(1, -0.4, 0.2, -0.1)))
    drops = write_scene(tmp_path, wrong, mesh, SceneConfig(contact_probes=200)).checks["drops"]
    there = {d["object"]: d["error_m"] for d in drops if d["platform"] == "platform_0"}
    assert there == pytest.approx({"sphere": -0.2, "box": -0.2}, abs=0.003)
    assert max(abs(d["error_m"]) for d in drops if d["platform"] != "platform_0") < 0.003


def test_a_drop_on_a_tilted_top_says_how_high_it_is_there(tmp_path: Path) -> None:
    """A sphere would roll off it; what lies on a plane of tilt t has its centre r / cos t above the plane."""
    degrees, top = 20, box(0, 0, 0.8, 0.8, 0.0)
    high = top.vertices[:, 2] > -0.01
    top.vertices[high, 2] += np.tan(np.radians(degrees)) * top.vertices[high, 0]
    mesh = terrain_mesh([top])
    start = platform(0, 0, 0.8, 0.0, "start")
    files = write_scene(tmp_path, scene(mesh, (start,)), mesh, SceneConfig(contact_probes=200))
    raised = 0.04 / np.cos(np.radians(degrees)) - 0.04
    for drop in files.checks["drops"]:
        assert drop["error_m"] == pytest.approx(raised, abs=0.003)


def test_unknown_contact_lists_those_that_are(tmp_path: Path) -> None:
    aligned, mesh = two_platforms()
    with pytest.raises(UnknownNameError, match="hfield"):
        write_scene(tmp_path, aligned, mesh, SceneConfig(contact="hfeild"))


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    aligned, mesh = two_platforms()
    real, calls = os.fdopen, []

    class Full(io.BytesIO):
        def write(self, data) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    def fdopen(handle: int, *args, **kwargs):
        calls.append(handle)
        if len(calls) < 3:
            return real(handle, *args, **kwargs)
        os.close(handle)
        return Full()

    monkeypatch.setattr(os, "fdopen", fdopen)
    with pytest.raises(RealsimError, match="free some space"), output_folder(tmp_path / "scene") as folder:
        write_scene(folder, aligned, mesh, SceneConfig(contact="hull", contact_probes=100))
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=25, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(2, 6), st.integers(2, 6)), elements=st.floats(-1, 1, width=32)))
def test_height_fields_come_out_as_they_went_in(heights: np.ndarray) -> None:
    """Row order, column order, offset and MuJoCo's renormalisation, on maps without any symmetry."""
    model_heights, lower, spacing = compiled_nodes(heights)
    np.testing.assert_allclose(model_heights, heights, atol=1e-5)
    np.testing.assert_allclose(lower, [0.5, -0.25], atol=1e-6)
    np.testing.assert_allclose(spacing, [0.1, 0.2], atol=1e-6)


def compiled_nodes(heights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(world z of the nodes as compiled, x y of node [0, 0], spacing) through hfield() and a compiled model."""
    rows, columns = heights.shape
    x, y = 0.5 + 0.1 * np.arange(columns), -0.25 + 0.2 * np.arange(rows)
    X, Y = np.meshgrid(x, y)
    vertices = np.stack([X, Y, heights], -1).reshape(-1, 3)
    grid = HeightGrid(np.array([x[0], y[0]]), np.array([0.1, 0.2]), heights)
    module = import_module("realsim.export.contact.hfield")

    patch = pytest.MonkeyPatch()
    patch.setattr(module, "height_grid", lambda vertices, triangles, resolution: grid)
    try:
        mesh = TerrainMesh(vertices, np.array([[0, 1, columns]], np.int32), None, np.zeros(1, bool), None, "", 0.1)  # type: ignore[arg-type]
        contact = hfield(Shape(mesh, -1.0), SceneConfig())
    finally:
        patch.undo()
    geom, asset = contact.geoms[0], contact.assets[0]
    xml = (
        f'<mujoco><asset><hfield name="t" file="t.hfield" content_type="image/vnd.mujoco.hfield" '
        f'size="{asset.attributes["size"]}"/></asset><worldbody><geom type="hfield" hfield="t" '
        f'pos="{" ".join(map(repr, geom.pos))}"/></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(xml, {"t.hfield": asset.data})
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    z = model.hfield_data.reshape(rows, columns) * model.hfield_size[0, 2] + data.geom_xpos[0, 2]
    # An off-node ray tells the row order as the collider sees it, not as the array is laid out.
    for i, j in [(0, 0), (rows - 1, 0), (0, columns - 1), (rows - 1, columns - 1)]:
        inward = np.array([0.5 * (x[0] + x[-1]) - x[j], 0.5 * (y[0] + y[-1]) - y[i]]) * 1e-4
        origin = np.array([x[j] + inward[0], y[i] + inward[1], 5.0])
        hit = np.zeros(1, np.int32)
        distance = mujoco.mj_ray(model, data, origin, np.array([0, 0, -1.0]), None, 1, -1, hit)
        assert 5 - distance == pytest.approx(heights[i, j], abs=2e-3)
    half = model.hfield_size[0, :2]
    lower = data.geom_xpos[0, :2] - half
    return z, lower, 2 * half / (columns - 1, rows - 1)


def test_holes_become_ground_and_are_said() -> None:
    part = box(0, 0, 0.4, 0.4, 0)
    lone = trimesh.util.concatenate([part, box(1, 0, 0.4, 0.4, 0)])
    quality = terrain_mesh([part]).quality
    mesh = TerrainMesh(
        np.asarray(lone.vertices),
        np.asarray(lone.faces, np.int32),
        None,
        np.zeros(len(lone.faces), bool),
        quality,
        "",
        0,
    )
    contact = hfield(Shape(mesh, GROUND), SceneConfig())
    assert contact.statistics["nodes_without_surface"] > 0
    assert "taken to be ground" in contact.warnings[0]


def test_an_enormous_mesh_is_refused() -> None:
    mesh = terrain_mesh([box(0, 0, 400, 400, 0)])
    with pytest.raises(ExportError, match="mesh's unit"):
        hfield(Shape(mesh, GROUND), SceneConfig(contact="hfield"))


def test_baked_colours_are_those_of_the_vertices() -> None:
    """Reading the texture at a corner's coordinate gives that vertex's colour, at the middle the mean."""
    import cv2

    mesh = terrain_mesh([box(0, 0, 0.5, 0.3, 0)])
    assert mesh.colors is not None
    png, uv = bake(mesh.vertices, mesh.triangles, mesh.colors)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(float)
    side = image.shape[0]
    pixel = np.stack([uv[..., 0], 1 - uv[..., 1]], -1) * side - 0.5
    read = np.array([[image[round(y), round(x)] for x, y in corners] for corners in pixel])
    np.testing.assert_allclose(read, mesh.colors[mesh.triangles], atol=0.5)


def test_normals_point_out_of_a_sphere() -> None:
    ball = trimesh.creation.icosphere(3)
    normals = vertex_normals(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))
    np.testing.assert_allclose(normals, ball.vertices, atol=0.02)


def test_every_registered_representation_can_be_loaded() -> None:
    assert all(callable(CONTACT[name]) for name in CONTACT)
