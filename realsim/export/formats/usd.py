"""USD with physics: the scan to look at, and collision geometry as PhysX (Isaac Sim, Isaac Lab) takes it."""

from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import MissingExtraError
from realsim.core.files import write_text
from realsim.core.geometry import R_to_quat
from realsim.export.formats.scene import Box, Convex, SceneOnDisk
from realsim.export.gltf import linear_rgb


def usd(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """terrain.usda: metres, z up, default prim /terrain; boxes as cubes, parts as convex hulls, height fields as
    triangle meshes, all with CollisionAPI and of purpose `guide`.

    Raises:
        MissingExtraError: usd-core is not installed.
    """
    stage = new_stage()
    from pxr import UsdGeom, UsdPhysics

    scan = _mesh(stage, "/terrain/scan", scene.vertices, scene.triangles)
    if scene.colors is not None:
        scan.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(_vec3(linear_rgb(scene.colors)))
    UsdGeom.Xform.Define(stage, "/terrain/collision")
    for box in scene.all_boxes():
        _cube(stage, f"/terrain/collision/{box.name}", box)
    for part in scene.convex:
        _collider(stage, part, UsdPhysics.Tokens.convexHull)
    for part in scene.surfaces:
        _collider(stage, part, UsdPhysics.Tokens.none)
    path = folder / "terrain.usda"
    write_text(path, stage.GetRootLayer().ExportToString())
    return [path]


def terrain_usda(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """A stage with one mesh, /terrain/mesh, that is looked at and touched as it is: (V, 3) metres, (K, 3).

    Raises:
        MissingExtraError: usd-core is not installed.
    """
    stage = new_stage()
    from pxr import UsdPhysics

    mesh = _mesh(stage, "/terrain/mesh", vertices, triangles)
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
    return str(stage.GetRootLayer().ExportToString())


def new_stage() -> Any:
    """An empty stage in memory: metres, kilograms, z up, default prim /terrain."""
    try:
        from pxr import Usd, UsdGeom, UsdPhysics
    except ImportError as error:
        raise MissingExtraError("usd-core", "usd", "the USD export") from error

    stage = Usd.Stage.CreateInMemory("terrain.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/terrain").GetPrim())
    return stage


def _vec3(rows: np.ndarray) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows, np.float32))


def _mesh(stage: Any, path: str, vertices: np.ndarray, triangles: np.ndarray) -> Any:
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(_vec3(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(triangles.ravel(), np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(_vec3(np.stack([vertices.min(0), vertices.max(0)])))
    return mesh


def _cube(stage: Any, path: str, box: Box) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(2.0)  # from -1 to 1: the scale is the half size
    cube.CreateExtentAttr(_vec3(np.array([[-1, -1, -1], [1, 1, 1]])))
    cube.AddTranslateOp().Set(Gf.Vec3d(*map(float, box.position)))
    w, x, y, z = map(float, R_to_quat(box.rotation))
    cube.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
    cube.AddScaleOp().Set(Gf.Vec3f(*map(float, box.half)))
    cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())


def _collider(stage: Any, part: Convex, approximation: str) -> None:
    from pxr import UsdGeom, UsdPhysics

    mesh = _mesh(stage, f"/terrain/collision/{part.name}", part.vertices, part.triangles)
    mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(approximation)
