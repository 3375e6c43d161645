"""`realsim footholds`: a robot's log against the scene on which it walked."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult, strict_exit, verdict_lines
from realsim.core.progress import steps


def footholds(
    case: Annotated[Path, tyro.conf.Positional],
    scene: Annotated[Path | None, tyro.conf.arg(metavar="STR")] = None,
    out: Path = Path("footholds"),
    overwrite: bool = False,
    strict: bool = False,
) -> CommandResult:
    """Say which foothold is higher, lower, tilted, softer, more slippery or wobbling than scanned, and by how much.

    Args:
        case: a folder with log.json, model.xml and runs/, with base pose, contacts and joint positions in every run.
        scene: scene.xml on which the robot walked, or its folder; the terrain in the case's model.xml if not given.
        out: gets footholds.json, report.html with the map, and scene.xml as it was found.
        overwrite: replace an output folder that realsim wrote before.
        strict: exit with code 3 if the verdict is "do not use".
    """
    from realsim.gap.checks.footholds.run import run_scene

    with steps() as tick:
        data = run_scene(case, scene, out, tick, overwrite=overwrite)
    verdict = data["verdict"]
    lines = [
        *verdict_lines(verdict),
        f"footholds  {len(data['footholds'])}, {data['contacts']} contacts",
        f"scene      {out / 'scene.xml'} (corrected)",
        f"report     {out / 'report.html'}",
        *(f"note       {note}" for note in data["notes"]),
    ]
    return CommandResult("\n".join(lines), data, strict_exit(verdict, strict), verdict["level"])
