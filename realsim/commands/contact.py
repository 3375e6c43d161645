"""`realsim contact`: collision geometry for any mesh from anywhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim.commands import CommandResult
from realsim.export import contact_mesh
from realsim.export.config import SceneConfig
from realsim.files import output_folder


@dataclass(frozen=True)
class ContactOptions:
    scene: SceneConfig = field(default_factory=SceneConfig)
    unit: Literal["m", "cm", "mm", "inch"] = "m"
    """Unit of the file's numbers."""
    up: Literal["auto", "z", "y"] = "auto"
    """Axis that points up; `auto` is y for GLB and z for the rest."""
    ground: float | None = None
    """z of the ground in metres; found from the mesh if not given."""
    overwrite: bool = False
    """Replace an output folder that exists."""


def contact(
    mesh: Annotated[Path, tyro.conf.Positional], config: ContactOptions, out: Path = Path("contact")
) -> CommandResult:
    """Give a mesh the cheapest collision geometry that matches it, and say in millimetres how well.

    Args:
        mesh: .ply, .obj, .stl, .glb or .off.
        out: gets scene.xml, contact.json (all figures) and contact.png (where it is off).
    """
    with output_folder(out, overwrite=config.overwrite) as folder:
        files = contact_mesh(mesh, folder, config.scene, unit=config.unit, up=config.up, ground_z=config.ground)
    c = files.contact
    geoms = ", ".join(f"{count} {kind}" for kind, count in c["geoms"].items())
    lines = [
        f"scene    {out / 'scene.xml'}",
        f"contact  {c['representation']}: {geoms}",
        f"error    {c['median_mm']:.2f} mm median, {c['p95_mm']:.2f} mm p95, {c['max_mm']:.1f} mm at most",
        f"phantom  {c['phantom_area_cm2']:.0f} cm2, missing {c['missing_area_cm2']:.0f} cm2, leaks {c['leaks']}",
        f"cost     {c['step_cost_vs_plane']:.2f} times a plane's step with G1 standing",
        *(f"note     {note}" for note in c["mended"]),
        *(f"warning  {warning}" for warning in files.warnings),
    ]
    return CommandResult("\n".join(lines), {"scene_xml": str(out / "scene.xml"), "contact": dict(c)})
