"""`realsim export`: a scene in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim.commands import CommandResult
from realsim.errors import RealsimError
from realsim.exports import EXPORTERS, export_scene


def export(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    to: str = "",
    profile: Literal["cpu", "warp"] = "cpu",
    out: Path | None = None,
) -> CommandResult:
    """Write a scene in the formats of other tools: mjcf, warp, usd, urdf, sdf, terrain, glb, obj, stl, ply, heightmap.

    Args:
        scene: a folder made by `realsim reconstruct` or `realsim contact`.
        to: formats, separated by commas; mjcf if a profile is all that is asked for.
        profile: of mjcf: as the CPU runs it, or for MuJoCo Warp (`--to warp` says the same).
        out: gets one folder a format; SCENE/export if not given.
    """
    names = [name.strip() for name in to.split(",") if name.strip()]
    if profile == "warp":
        names = [("warp" if name == "mjcf" else name) for name in names or ["mjcf"]]
    if not names:
        raise RealsimError("no format given", expected=f"--to with some of {', '.join(EXPORTERS)}, separated by commas")
    written = export_scene(scene, names, out)
    lines = []
    for name, (first, *others) in written.items():
        more = f" and {len(others)} more file{'s' if len(others) > 1 else ''}" if others else ""
        lines.append(f"{name:<10} {first}{more}")
    return CommandResult("\n".join(lines), {name: [str(p) for p in paths] for name, paths in written.items()})
