"""Collision geometry for any mesh from anywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from realsim.exports.config import SceneConfig
from realsim.exports.contact.heatmap import heatmap_png
from realsim.exports.mend import ground_height, read_mesh
from realsim.exports.scene import write_terrain
from realsim.files import to_json, write_bytes, write_text
from realsim.types import SceneFiles


def contact_mesh(
    mesh: Path,
    folder: Path,
    config: SceneConfig,
    *,
    unit: str | None = None,
    up: str = "auto",
    ground_z: float | None = None,
) -> SceneFiles:
    """A mesh file becomes a scene folder with measured collision geometry, contact.json and contact.png.

    The frame is the file's own (z up, metres).

    Args:
        mesh: .ply, .obj, .stl, .glb or .off.
        folder: exists, empty.
        unit: of the file: m, cm, mm or inch; None for metres, up to 50 of them.
        up: axis that points up: z, y or auto.
        ground_z: metres; found from the mesh if None.

    Raises:
        ExportError: the mesh cannot be used, or the scene does not hold.
    """
    terrain, notes = read_mesh(mesh, unit, up)
    ground = ground_height(terrain) if ground_z is None else ground_z
    if ground_z is None:
        notes.append(f"the ground was taken to be at z = {ground:.3f} m")
    files = write_terrain(folder, terrain, ground, config)
    contact = dict(files.contact) | {"mesh": mesh.name, "ground_z": ground, "mended": notes}
    write_text(folder / "contact.json", to_json(contact))
    if files.contact_map is not None:
        write_bytes(folder / "contact.png", heatmap_png(files.contact_map))
    return replace(files, contact=contact)
