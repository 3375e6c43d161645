"""`realsim contact`: collision geometry for any mesh from anywhere."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim import robots
from realsim.cli.commands import CommandResult, describe_sides, strict_exit, verdict_lines
from realsim.cli.commands.many import run_each
from realsim.core.errors import RealsimError
from realsim.core.files import output_folder
from realsim.export.config import SceneConfig
from realsim.jobs import ManyConfig


def contact(
    meshes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MESH ...", help_behavior_hint="")],
    config: SceneConfig,
    out: Path = Path("contact"),
    unit: Literal["m", "cm", "mm", "inch"] | None = None,
    up: Literal["auto", "z", "y"] = "auto",
    ground_z: float | None = None,
    overwrite: bool = False,
    strict: bool = False,
    many: ManyConfig = ManyConfig(),
) -> CommandResult:
    """Give a mesh collision geometry for MuJoCo, chosen by measured error and cost, and say how far it is off.

    Args:
        meshes: .ply, .obj, .stl, .glb or .off; with several, each gets a folder of its name below --out.
        out: gets scene.xml, the mesh, contact.json, contact.png and a page, report.html.
        unit: unit of the file; by default metres, but a mesh of more than 50 m is then refused.
        up: axis of the file that points up.
        ground_z: height of the ground in metres; by default the mesh's own floor, otherwise its lowest point.
        overwrite: replace a folder that realsim wrote before.
        strict: exit with code 3 if the verdict is "do not use" (the scene is written all the same).
    """
    if not meshes:
        raise RealsimError("no mesh given", expected="realsim contact MESH --out DIR")
    if len(meshes) > 1 or many.place != "processes":
        return run_each("contact", meshes, out, many, shows="scene_xml")
    from realsim.export import contact_mesh
    from realsim.report.contact_page import write_contact_page

    (mesh,) = meshes
    if config.robot is not None:
        robots.load(config.robot)  # before a minute of work
    with output_folder(out, overwrite=overwrite, source=mesh) as folder:
        files = contact_mesh(mesh, folder, config, unit=unit, up=up, ground_z=ground_z)
        write_contact_page(folder, files)
    c = dict(files.contact)
    drop = c["drop"]
    lines = [
        *verdict_lines(c["verdict"]),
        f"scene          {out / 'scene.xml'}",
        f"report         {out / 'report.html'}",
        f"ground         {c['ground']}",
        f"representation {c['representation']}, {sum(c['geoms'].values())} geoms",
        f"error          {c['median_mm']:.1f} mm median, {c['p95_mm']:.1f} mm at the 95th percentile",
        f"phantom        {c['phantom_area_cm2']:.0f} cm2, missing {c['missing_area_cm2']:.0f} cm2, "
        f"{c['leaks']} leak{'s' * (c['leaks'] != 1)}",
        f"heights        {drop['phantom_share'] + drop['missing_share']:.1%} off by more than 2 cm",
        f"sides          {describe_sides(c['sides'])}",
        f"step cost      {c['step_cost_vs_plane']:.2f} times a plane's",
        *(f"mended         {note}" for note in c["mended"]),
        *(f"note           {warning}" for warning in files.warnings),
    ]
    verdict = c["verdict"]
    data = {
        "verdict": verdict,
        "scene_xml": str(out / "scene.xml"),
        "report": str(out / "report.html"),
        "contact": c,
        "warnings": list(files.warnings),
    }
    return CommandResult("\n".join(lines), data, strict_exit(verdict, strict), verdict["level"])
