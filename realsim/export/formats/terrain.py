"""One closed mesh with a flat border, about its own centre: what Isaac Lab imports as a terrain (not run here)."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import ExportError, MissingExtraError
from realsim.core.files import to_json, write_bytes, write_text
from realsim.core.meshes import vertex_normals
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.formats.usd import terrain_usda
from realsim.export.visual import obj_bytes

BORDER = 5.0  # metres of floor around the terrain
THICKNESS = 0.2  # metres of floor


def terrain(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """terrain.obj and terrain.usda: the union of all collision solids and the floor, x y about the middle of the
    terrain, the floor at z = 0; terrain.json: how far it was moved, and where start and goal are. The USD is left out
    where usd-core is not installed.

    A triangle mesh is what these simulators collide with, and this one is made of the very solids that MuJoCo has.
    """
    from manifold3d import Manifold

    floor = scene.floor_box(BORDER)
    z = scene.floor_z if scene.floor_z is not None else float(scene.bounds[0, 2])
    shift = -np.array([*scene.bounds.mean(0)[:2], z])
    solids = [Manifold.hull_points(part.vertices + shift) for part in scene.convex]
    solids += [_above_floor(part.vertices + shift, part.triangles) for part in scene.surfaces]
    solids += [Manifold.hull_points(box.corners + shift) for box in scene.boxes]
    whole = Manifold()
    for solid in solids:
        whole += solid
    if floor is not None:
        size = [*(2 * floor.half[:2]), THICKNESS]
        whole += Manifold.cube(size, True).translate([0, 0, -THICKNESS / 2])
    mesh = whole.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, float)[:, :3]
    triangles = np.asarray(mesh.tri_verts, np.int32)
    write_bytes(folder / "terrain.obj", obj_bytes(vertices, triangles, vertex_normals(vertices, triangles)))
    places = {name: {"center": centre + shift, "half_size": half} for name, (centre, half) in scene.sites.items()}
    metadata = {"T_terrain_sim_translation": shift, "border_m": BORDER, "units": "metres, z up", "platforms": places}
    write_text(folder / "terrain.json", to_json(metadata))
    written = [folder / "terrain.obj", folder / "terrain.json"]
    with suppress(MissingExtraError):
        write_text(folder / "terrain.usda", terrain_usda(vertices, triangles))
        written.append(folder / "terrain.usda")
    return written


def _above_floor(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    """A height field's surface, (V, 3) and (K, 3) seen from above, as a solid that reaches THICKNESS below its lowest
    point."""
    from manifold3d import Manifold, Mesh64

    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    known = {tuple(e) for e in edges.tolist()}
    a, b = np.array([e for e in edges.tolist() if (e[1], e[0]) not in known]).T
    count = len(vertices)
    below = np.column_stack([vertices[:, :2], np.full(count, vertices[:, 2].min() - THICKNESS)])
    sides = np.concatenate([np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)])
    faces = np.concatenate([triangles, triangles[:, ::-1] + count, sides])
    solid = Manifold(Mesh64(np.concatenate([vertices, below]), faces.astype(np.uint64)))
    if solid.is_empty():
        raise ExportError("the height field does not make a solid", found=str(solid.status()))
    return solid
