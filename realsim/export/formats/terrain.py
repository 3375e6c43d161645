"""One closed mesh with a flat border, about its own centre: what Isaac Lab and mjlab import as a terrain."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from realsim.errors import ExportError
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.visual import obj_bytes, vertex_normals
from realsim.files import to_json, write_bytes, write_text

BORDER = 5.0  # metres of floor around the terrain
THICKNESS = 0.2  # metres of floor


def terrain(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """terrain.obj: the union of all collision solids and the floor, x y about the middle of the terrain, the floor at
    z = 0; terrain.json: how far it was moved, and where start and goal are.

    A triangle mesh is what these simulators collide with, and this one is made of the very solids that MuJoCo has.
    """
    from manifold3d import Manifold

    if scene.surfaces:
        raise ExportError(
            "a height field is no solid", file=scene.folder, hint="reconstruct with --scene.contact boxes"
        )
    floor = scene.floor_box(BORDER)
    z = scene.floor_z if scene.floor_z is not None else float(scene.bounds[0, 2])
    shift = -np.array([*scene.bounds.mean(0)[:2], z])
    solids = [Manifold.hull_points(part.vertices + shift) for part in scene.convex]
    for box in scene.boxes:
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        solids.append(Manifold.hull_points((signs * box.half) @ box.rotation.T + box.position + shift))
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
    return [folder / "terrain.obj", folder / "terrain.json"]
