"""Every format is read back with what its users read it with, and holds the same geometry."""

import ctypes
import ctypes.util
import importlib.util
import json
import runpy
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh
from defusedxml import ElementTree

from realsim.cli.commands.export import export
from realsim.core.errors import ExportError, UnknownNameError
from realsim.core.rays import Rays
from realsim.export import EXPORTERS, export_scene, write_scene
from realsim.export.config import SceneConfig
from realsim.export.formats import load_scene
from realsim.export.formats.scene import collision_triangles

from .terrain import GROUND, two_platforms


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene with boxes, a prism (the wedge of the mesh is the step turned up) and a floor plane."""
    folder = tmp_path_factory.mktemp("scene")
    aligned, mesh = two_platforms()
    write_scene(folder, aligned, mesh, SceneConfig(contact="boxes", contact_probes=200, robot="g1"))
    return folder


@pytest.fixture(scope="module")
def exported(folder: Path) -> dict[str, list[Path]]:
    return export_scene(folder, list(EXPORTERS))


def test_a_scene_reads_back_as_it_was_written(folder: Path) -> None:
    scene = load_scene(folder)
    assert scene.floor_z == pytest.approx(GROUND)
    assert len(scene.boxes) + len(scene.convex) == 3
    assert set(scene.sites) == {"start", "goal"}
    assert scene.colors is not None


@pytest.mark.parametrize("name", list(EXPORTERS))
def test_exports_are_repeatable(folder: Path, exported: dict[str, list[Path]], tmp_path: Path, name: str) -> None:
    again = export_scene(folder, [name], tmp_path)[name]
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in exported[name]]


@pytest.mark.parametrize("name", ["glb", "obj", "stl", "ply"])
def test_meshes_hold_the_scan(folder: Path, exported: dict[str, list[Path]], name: str) -> None:
    scene = load_scene(folder)
    mesh = trimesh.load(exported[name][0], force="mesh", process=False)
    assert len(mesh.faces) == len(scene.triangles)
    corners = np.asarray(mesh.triangles).reshape(-1, 3)
    if name == "glb":  # y up
        corners = np.column_stack([corners[:, 0], -corners[:, 2], corners[:, 1]])
    np.testing.assert_allclose(corners, scene.vertices[scene.triangles].reshape(-1, 3), atol=2e-5)


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("glb", "terrain.glb"),
        ("obj", "terrain.obj"),
        ("ply", "terrain.ply"),
        ("sdf", "meshes/visual.obj"),
        ("urdf", "visual.obj"),
        ("mjcf", "visual.obj"),
    ],
)
def test_every_format_that_is_looked_at_keeps_its_colours(
    folder: Path, exported: dict[str, list[Path]], name: str, file: str
) -> None:
    scene = load_scene(folder)
    assert scene.colors is not None
    path = next(p for p in exported[name] if str(p).endswith(file))
    if name == "mjcf":  # the material stands in scene.xml
        image = next(p for p in exported[name] if p.suffix == ".png")
        assert image.name in exported[name][0].read_text()
        (path.parent / "visual.mtl").write_text(f"newmtl m\nKd 1 1 1\nmap_Kd {image.relative_to(path.parent)}\n")
        text = path.read_text()
        path = path.with_name("shown.obj")
        path.write_text("mtllib visual.mtl\nusemtl m\n" + text)
    mesh = trimesh.load(path, force="mesh", process=False)
    shown = np.asarray(
        mesh.visual.to_color().vertex_colors if mesh.visual.kind == "texture" else mesh.visual.vertex_colors
    )
    found = shown[np.asarray(mesh.faces), :3].reshape(-1, 3).astype(int)
    expected = scene.colors[scene.triangles].reshape(-1, 3).astype(int)
    assert len(found) == len(expected)
    assert np.abs(found - expected).max() <= 4
    assert np.ptp(expected, axis=0).max() > 20, "a scan of one colour would show nothing"


@pytest.mark.parametrize("name", ["mjcf", "warp", "urdf"])
def test_what_mujoco_reads_has_the_same_heights(folder: Path, exported: dict[str, list[Path]], name: str) -> None:
    """A ray down onto collision geometry; URDF goes through MuJoCo's own URDF reader."""
    model = mujoco.MjModel.from_xml_path(str(exported[name][0]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    visible = np.array([1, 0, 0, 1, 0, 0], np.uint8)
    hit = np.zeros(1, np.int32)
    for x, y, z in [(0.1, 0.3, 0.0), (2.1, 0.3, 0.05), (1.0, 0.1, -0.2), (1.0, -0.6, GROUND)]:
        start = np.array([x, y, 0.3])
        distance = mujoco.mj_ray(
            model, data, start, np.array([0, 0, -1.0]), visible, 1, 0 if name == "mjcf" else -1, hit
        )
        if name == "mjcf":  # the robot's body is in the way of nothing here, the floor is of the world
            distance = mujoco.mj_ray(model, data, start, np.array([0, 0, -1.0]), visible, 1, -1, hit)
        assert 0.3 - distance == pytest.approx(z, abs=0.002)


def test_a_drawn_mesh_that_was_cut_off_is_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "scene")
    path = tmp_path / "scene" / "visual.obj"
    lines = path.read_text().splitlines(keepends=True)
    faces = [i for i, line in enumerate(lines) if line.startswith("f ")]
    path.write_text("".join(lines[: faces[len(faces) // 10]]))
    with pytest.raises(ExportError, match="cut off"):
        export_scene(tmp_path / "scene", ["mjcf"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_warp_profile_is_primitives_with_bits_and_advice(exported: dict[str, list[Path]]) -> None:
    model = mujoco.MjModel.from_xml_path(str(exported["warp"][0]))
    assert (model.geom_contype == 1).all()
    assert (model.geom_conaffinity == 0).all()
    assert set(model.geom_type.tolist()) <= {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_BOX)}
    advice = json.loads(exported["warp"][1].read_text())
    assert advice["nconmax_per_world"] >= advice["measured"]["contacts"] > 0


def test_the_warp_profile_of_mjcf_is_the_warp_format(folder: Path, tmp_path: Path) -> None:
    result = export((folder,), to="mjcf,ply", profile="warp", out=tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"warp", "ply"}
    assert (tmp_path / "warp" / "terrain.xml").is_file()
    assert "and 1 more file" in result.text


def test_usd_is_metric_upright_and_collides(folder: Path, exported: dict[str, list[Path]]) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(exported["usd"][0]))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/terrain"
    colliders = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.CollisionAPI)]
    scene = load_scene(folder)
    assert len(colliders) == len(scene.all_boxes()) + len(scene.convex)
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "guide"])
    for box in scene.boxes:
        prim = stage.GetPrimAtPath(f"/terrain/collision/{box.name}")
        bound = cache.ComputeWorldBound(prim).ComputeAlignedRange()
        reach = np.abs(box.rotation) @ box.half
        np.testing.assert_allclose(bound.GetMin(), box.position - reach, atol=1e-4)
        np.testing.assert_allclose(bound.GetMax(), box.position + reach, atol=1e-4)
    scan = UsdGeom.Mesh(stage.GetPrimAtPath("/terrain/scan"))
    np.testing.assert_allclose(np.array(scan.GetPointsAttr().Get()), scene.vertices, atol=1e-5)


def test_sdf_has_every_collision_and_its_files(folder: Path, exported: dict[str, list[Path]]) -> None:
    path = exported["sdf"][0]
    root = ElementTree.parse(path).getroot()
    assert root.find("model/static").text == "true"
    scene = load_scene(folder)
    collisions = root.findall("model/link/collision")
    assert len(collisions) == 1 + len(scene.boxes) + len(scene.convex)
    sizes = {c.get("name"): c.find("geometry/box/size").text for c in collisions if c.find("geometry/box") is not None}
    for box in scene.boxes:
        np.testing.assert_allclose(np.array(sizes[box.name].split(), float), 2 * box.half, rtol=1e-6)
    for uri in root.iter("uri"):
        assert (path.parent / uri.text).is_file()


def test_gazebos_own_parser_takes_the_sdf(exported: dict[str, list[Path]], tmp_path: Path) -> None:
    """What `gz sdf --check` calls; the library comes with Debian's libsdformat (tools/system_packages.sh)."""
    found = ctypes.util.find_library("sdformat12") or ctypes.util.find_library("sdformat14")
    if found is None:
        pytest.skip("Gazebo's libsdformat is not installed")
    check = ctypes.CDLL(found).cmdCheck
    assert check(str(exported["sdf"][0]).encode()) == 0
    spoilt = tmp_path / "model.sdf"
    spoilt.write_text(exported["sdf"][0].read_text().replace("<size>", "<size>x", 1))
    assert check(str(spoilt).encode()) != 0


def test_terrain_mesh_is_closed_centred_and_flat_at_the_border(exported: dict[str, list[Path]]) -> None:
    mesh = trimesh.load(exported["terrain"][0], force="mesh")
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.bounds.mean(0)[:2], 0, atol=1e-3)
    about = json.loads(exported["terrain"][1].read_text())
    start = np.array(about["platforms"]["start"]["center"])
    assert start[2] == pytest.approx(-GROUND, abs=1e-3)
    surface = Rays(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))
    assert surface.height(start[None, :2])[0] == pytest.approx(start[2], abs=0.002)


def test_terrain_stage_holds_the_same_mesh(exported: dict[str, list[Path]]) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    mesh = trimesh.load(exported["terrain"][0], force="mesh", process=False)
    stage = Usd.Stage.Open(str(exported["terrain"][2]))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 1.0)
    prim = stage.GetPrimAtPath("/terrain/mesh")
    assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == UsdPhysics.Tokens.none
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get())
    faces = np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_allclose(points[faces], np.asarray(mesh.triangles), atol=2e-5)


@dataclass
class _SubTerrain:
    """What mjlab 1.6 hands to a sub-terrain, where mjlab is not installed."""

    size: tuple[float, float] = (10.0, 10.0)


def _in_mjlab(module: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[mujoco.MjModel, np.ndarray]:
    """(model, where robots begin) of one patch with its corner at the origin."""
    if importlib.util.find_spec("mjlab") is None:
        names = {"SubTerrainCfg": _SubTerrain, "TerrainGeometry": SimpleNamespace, "TerrainOutput": lambda *a: a}
        for name in ("mjlab", "mjlab.terrains", "mjlab.terrains.terrain_generator"):
            monkeypatch.setitem(sys.modules, name, SimpleNamespace(**names))
    content = runpy.run_path(str(module))
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="terrain")
    with pytest.raises(ValueError, match="size="):
        content["ScannedTerrainCfg"](size=(0.5, 0.5)).function(0.0, spec, np.random.default_rng(0))
    made = content["ScannedTerrainCfg"](size=content["SIZE"]).function(0.0, spec, np.random.default_rng(0))
    return spec.compile(), made[0] if isinstance(made, tuple) else made.origin


def test_a_sub_terrain_of_mjlab_has_the_same_heights(
    folder: Path, exported: dict[str, list[Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(folder)
    model, origin = _in_mjlab(exported["mjlab"][0], monkeypatch)
    moved = np.array([*(np.ptp(scene.bounds, axis=0)[:2] / 2 + 1.0 - scene.bounds.mean(0)[:2]), -GROUND])
    for x, y, z in [(0.1, 0.3, 0.0), (2.1, 0.3, 0.05), (1.0, 0.1, -0.2), (1.0, -0.6, GROUND)]:
        assert _height(model, x + moved[0], y + moved[1]) == pytest.approx(z - GROUND, abs=0.002)
    np.testing.assert_allclose(origin, scene.sites["start"][0] + moved, atol=1e-4)


def _height(model: mujoco.MjModel, x: float, y: float) -> float:
    """Of what a ray down from 1 m meets."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit = np.zeros(1, np.int32)
    return 1 - mujoco.mj_ray(model, data, np.array([x, y, 1.0]), np.array([0, 0, -1.0]), None, 1, -1, hit)


def test_height_map_in_both_files(exported: dict[str, list[Path]]) -> None:
    import cv2

    npz, png, metadata = exported["heightmap"]
    arrays, m = np.load(npz, allow_pickle=False), json.loads(metadata.read_text())
    image = cv2.imread(str(png), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    z = np.where(image == m["unseen"], np.nan, m["offset_m"] + m["step_m"] * image)[::-1]
    np.testing.assert_allclose(z, arrays["z"], atol=1e-5)
    i, j = np.rint((np.array([0.0, 2.0]) - arrays["lower"][::-1]) / arrays["spacing"][::-1]).astype(int)
    assert arrays["z"][i, j] == pytest.approx(0.05, abs=1e-4)  # the goal, at y = 0 and x = 2


def test_a_height_field_is_exported_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    aligned, mesh = two_platforms()
    (tmp_path / "scene").mkdir()
    config = SceneConfig(contact="hfield", contact_probes=200, hfield_resolution=0.05)
    write_scene(tmp_path / "scene", aligned, mesh, config)
    names = ["warp", "usd", "urdf", "sdf", "mjlab"]
    files = export_scene(tmp_path / "scene", names, tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(files["warp"][0]))
    patch, _ = _in_mjlab(files["mjlab"][0], monkeypatch)
    bounds = load_scene(tmp_path / "scene").bounds
    dx, dy = np.ptp(bounds, axis=0)[:2] / 2 + 1.0 - bounds.mean(0)[:2]
    for x, y, z in [(0.1, 0.3, 0.0), (2.1, -0.2, 0.05), (1.05, 0.15, -0.2)]:
        assert _height(model, x, y) == pytest.approx(z, abs=1e-3)
        assert _height(patch, x + dx, y + dy) == pytest.approx(z - bounds[0, 2], abs=1e-3)
    solid = trimesh.load(export_scene(tmp_path / "scene", ["terrain"], tmp_path / "out")["terrain"][0], force="mesh")
    _, uses = np.unique(np.sort(solid.edges, axis=1), axis=0, return_counts=True)
    assert (uses % 2 == 0).all()  # closed; floor and field touch along some edges
    assert solid.is_winding_consistent
    surface = Rays(np.asarray(solid.vertices), np.asarray(solid.faces, np.int32))
    middle = (mesh.vertices.min(0) + mesh.vertices.max(0))[:2] / 2
    heights = surface.height(np.array([[0.1, 0.3], [2.1, -0.2], [10.0, 0.0]]) - middle)
    np.testing.assert_allclose(heights[:2] - heights[0], [0.0, 0.05], atol=1e-3)


def test_unknown_formats_and_folders_without_a_scene(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="usd"):
        export_scene(folder, ["glb", "usdx"], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(ExportError, match="not a scene folder"):
        export_scene(tmp_path, ["glb"])


def test_an_exporter_that_names_no_files_is_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXPORTERS.own, "obj", "builtins:print")  # writes nothing, and returns None
    with pytest.raises(ExportError, match="exporter of obj"):
        export_scene(folder, "obj", tmp_path / "out")
    assert not (tmp_path / "out" / "obj").exists()


def test_a_scene_with_entities_is_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "scene")
    (tmp_path / "scene" / "scene.xml").write_text('<!DOCTYPE a [<!ENTITY b "c">]><mujoco>&b;</mujoco>')
    with pytest.raises(ExportError, match="not plain XML"):
        load_scene(tmp_path / "scene")


def test_a_distance_field_collides_as_its_mesh_hollows_too() -> None:
    """The measure from the side and every exporter read it: `--contact sdf` had ended with an error."""
    ring = trimesh.creation.annulus(0.1, 0.3, 0.2)
    ring.apply_transform(trimesh.transformations.rotation_matrix(0.4, [1, 0, 0], [0, 0, 0]))
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ring", uservert=ring.vertices.ravel().tolist(), userface=ring.faces.ravel().tolist())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SDF, meshname="ring", pos=[0.5, 0.0, 0.3])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    vertices, triangles = collision_triangles(model, data)
    found = trimesh.Trimesh(vertices, triangles)
    assert found.is_watertight
    assert found.volume == pytest.approx(ring.volume, rel=1e-5)
    np.testing.assert_allclose(found.bounds, ring.bounds + np.array([0.5, 0.0, 0.3]), atol=1e-5)
