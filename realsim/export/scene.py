"""An aligned scene and its mesh become a folder that MuJoCo opens."""

from pathlib import Path

import numpy as np

from realsim import robots
from realsim.core.files import write_files, write_text
from realsim.core.meshes import compact, ply_bytes, simplify, vertex_normals
from realsim.core.types import F64, AlignedScene, Platform, SceneFiles, TerrainMesh
from realsim.export.check import check_scene
from realsim.export.config import SceneConfig
from realsim.export.contact.choose import fit_contact
from realsim.export.contact.shape import Solids
from realsim.export.gltf import glb_bytes
from realsim.export.mjcf import scene_xml
from realsim.export.visual import textured_obj

DRAWN_TRIANGLES = 80_000
"""Number of triangles that viewers draw fluently; the exact surface is in mesh.ply and mesh.glb."""


def write_scene(folder: Path, aligned: AlignedScene, mesh: TerrainMesh, config: SceneConfig) -> SceneFiles:
    """Write mesh.ply, mesh.glb, scene.xml and what it refers to; then compile, step and check it from disk.

    `mesh.ply` and `mesh.glb` hold the triangles that were seen and the tops of inferred platforms; collision geometry
    is made of all of them. The same input writes the same bytes.

    Args:
        folder: exists; nothing in it is kept if the export fails (the caller makes the folder whole or not at all).

    Raises:
        ExportError: the scene does not compile or step, or the robot does not stand.
        RealsimError: a file cannot be written.
    """
    start = aligned.platform("start")
    place = np.array([0.0, 0.0, aligned.ground_z]) if start is None else start.centroid
    stand = None if start is None else start.centroid
    return write_terrain(
        folder,
        mesh,
        aligned.ground_z,
        config,
        aligned.platforms,
        robot_at=place,
        cost_at=stand,
        azimuth=_seen_from(aligned),
    )


def write_terrain(
    folder: Path,
    mesh: TerrainMesh,
    ground_z: float,
    config: SceneConfig,
    platforms: tuple[Platform, ...] = (),
    *,
    robot_at: F64 | None = None,
    cost_at: F64 | None = None,
    azimuth: float = 60.0,
    bare: bool = False,
    solids: Solids | None = None,
) -> SceneFiles:
    """The same for a mesh with its ground alone.

    Args:
        robot_at: (3,) the ground under the robot's feet; the ground at the origin if None.
        cost_at: (3,) where G1 stands when the cost of a step is measured; the highest level place if None.
        azimuth: direction in which viewers look first, degrees from x to y.
        bare: whether the ground goes on where the mesh has no surface.
        solids: convex pieces that the mesh is made of, if it is.
    """
    fitted = fit_contact(mesh, ground_z, config, cost_at, bare=bare, solids=solids)
    contact = fitted.contact
    vertices, triangles, colors = compact(mesh.vertices, mesh.carrying, mesh.colors)
    normals = vertex_normals(vertices, triangles)
    files = {
        "mesh.ply": ply_bytes(vertices, triangles, colors),
        "mesh.glb": glb_bytes(vertices, triangles, normals, colors),
    }
    files |= textured_obj("visual", *simplify(vertices, triangles, colors, DRAWN_TRIANGLES))
    texture = "visual.png" if "visual.png" in files else None
    files |= {asset.file: asset.data for asset in contact.assets if asset.file}
    robot = None
    if config.robot:
        robot = robots.load(config.robot).placed(np.array([0, 0, ground_z]) if robot_at is None else robot_at)
        files |= robot.files | {"robot.xml": robot.spec.to_xml().encode()}
    bounds = np.stack([mesh.vertices.min(0), mesh.vertices.max(0)])
    include = "robot.xml" if robot else None
    xml = scene_xml(contact, platforms, bounds, visual="visual.obj", texture=texture, robot=include, azimuth=azimuth)
    write_files(folder, files)
    path = folder / "scene.xml"
    write_text(path, xml)
    checks = check_scene(path, platforms, robot.root if robot else None)
    touches = fitted.fidelity.touches
    return SceneFiles(
        folder,
        path,
        folder / "mesh.ply",
        folder / "mesh.glb",
        contact=fitted.summary,
        checks=checks,
        contact_map=np.column_stack([touches.start[:, :2], touches.error]),
        warnings=fitted.warnings,
    )


def _seen_from(aligned: AlignedScene) -> float:
    """Obliquely along the terrain or back, from the side on which the cameras were: that side has a surface."""
    if aligned.metric is None:
        return 60.0
    ahead = np.mean([aligned.T_sim_camera(i)[:2, 2] for i in range(len(aligned.metric))], axis=0)
    directions = np.radians([60.0, 120.0, -60.0, -120.0])
    best = np.argmax(np.cos(directions) * ahead[0] + np.sin(directions) * ahead[1])
    return float(np.degrees(directions[best]).round())
