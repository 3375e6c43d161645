"""The layers of a scene's 3D view: mesh, invented parts, collision geometry, robot, cameras, platforms, axes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.meshes import compact, merged, simplify
from realsim.core.types import AlignedScene, Reconstruction, TerrainMesh
from realsim.report import raster
from realsim.report.collision import collision_parts, load, robot_triangles, sharp_edges
from realsim.report.marks import Mark, marks_layer
from realsim.report.solids import Solid
from realsim.report.topdown import INVENTED
from realsim.report.viewer3d import Layer, camera_frustums, viewer

MESH_TRIANGLES, COLLISION_TRIANGLES = 60_000, 20_000
COLLISION, COLLISION_EDGES, ROBOT = (236, 148, 62), (196, 92, 14), (96, 108, 128)
PLATFORMS, CAMERAS = (226, 70, 120), (72, 132, 236)


def scene_view(folder: Path, result: Reconstruction, marks: Sequence[Mark] = (), *, unseen: bool = False) -> str:
    """The 3D view of a reconstruction whose scene lies in `folder`; it opens from where MuJoCo's viewer does.

    Args:
        marks: places to mark; unseen: whether what no camera saw is shown from the start.
    """
    model, data = load(folder / result.scene.scene_xml.name)
    layers = [
        *mesh_layers(result.mesh, unseen=unseen),
        *collision_layers(model),
        *robot_layers(model, data),
        *camera_layers(result.aligned),
        platform_layer(result.aligned),
        axes_layer(),
        *marks_layer(marks),
    ]
    return viewer(layers, label="the reconstructed scene in 3D", azimuth=float(model.vis.global_.azimuth))


def mesh_layers(mesh: TerrainMesh, *, unseen: bool = False) -> list[Layer]:
    """Seen surface in its own colours (or by height), and invented surface in violet, visible at first if `unseen`."""
    colors = mesh.colors
    if colors is None:
        z = mesh.vertices[:, 2]
        low, high = np.percentile(z, [1, 99])
        colors = raster.colorize(z, float(low), float(high))[:, :3]
    V, F, C = simplify(*compact(mesh.vertices, mesh.seen, colors), limit=MESH_TRIANGLES)
    seen = Layer("mesh", V, F, C)
    if not mesh.invented.any():
        return [seen]
    hidden = compact(mesh.vertices, mesh.triangles[mesh.invented])
    V, F, _ = simplify(hidden[0], hidden[1], None, COLLISION_TRIANGLES)
    return [seen, Layer("invented", V, F, INVENTED, visible=unseen)]


def collision_layers(model: Any) -> list[Layer]:
    """Collision geometry, transparent over the mesh, with the edges of its parts; one button for both."""
    parts = collision_parts(model)
    V, F, _ = simplify(*merged([part for part, _ in parts]), None, limit=COLLISION_TRIANGLES)
    lines: list[Solid] = [(part[0], sharp_edges(*part)) for part, edged in parts if edged]
    fill = Layer("collision", V, F, COLLISION, opacity=0.35)
    return [fill, Layer("collision", *merged(lines), COLLISION_EDGES, kind="lines")] if lines else [fill]


def robot_layers(model: Any, data: Any) -> list[Layer]:
    """The robot of the scene, if it has one."""
    V, F = robot_triangles(model, data)
    return [Layer("robot", V, F, ROBOT)] if len(F) else []


def camera_layers(aligned: AlignedScene) -> list[Layer]:
    """Every camera as a small pyramid, and the way between them."""
    if aligned.metric is None:
        return []
    T = np.stack([aligned.T_sim_camera(i) for i in range(len(aligned.metric))])
    k = aligned.metric.frames[0].intrinsics
    V, E = camera_frustums(T, k.width / 2 / k.fx, k.height / 2 / k.fy)
    n = len(T)
    V = np.vstack([V, T[:, :3, 3]])
    way = 5 * n + np.column_stack([np.arange(n - 1), np.arange(1, n)])
    return [Layer("cameras", V, np.vstack([E, way]), CAMERAS, kind="lines")]


def platform_layer(aligned: AlignedScene) -> Layer:
    """The outlines of the platforms' tops, with a post down to the ground at each corner."""
    vertices: list[Any] = []
    edges: list[Any] = []
    for p in aligned.platforms:
        n, at = len(p.outline), len(vertices)
        top = np.column_stack([p.outline, np.full(n, p.centroid[2] + 0.004)])
        foot = np.column_stack([p.outline, np.full(n, aligned.ground_z)])
        vertices += [*top, *foot]
        i = np.arange(n)
        edges += [*(at + np.column_stack([i, (i + 1) % n])), *(at + np.column_stack([i, n + i]))]
    return Layer("platforms", np.array(vertices).reshape(-1, 3), np.array(edges), PLATFORMS, kind="lines")


def axes_layer() -> Layer:
    """The simulation frame's axes, half a metre long: x red, y green, z blue."""
    tips = 0.5 * np.eye(3)
    V = np.stack([np.zeros((3, 3)), tips], axis=1).reshape(-1, 3) + np.array([0, 0, 0.006])
    C = np.repeat(np.array([[235, 64, 52], [52, 190, 84], [66, 122, 245]], np.uint8), 2, axis=0)
    return Layer("axes", V, np.arange(6).reshape(3, 2), C, kind="lines")
