"""`realsim export`: a scene in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from realsim.commands import CommandResult
from realsim.errors import RealsimError
from realsim.exports import EXPORTERS, export_scene

FORMATS = "all|mjcf,warp,usd,urdf,sdf,terrain,glb,obj,stl,ply,heightmap"
"""What --help shows; a test holds it to EXPORTERS."""


def export(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    to: Annotated[str, tyro.conf.arg(metavar=FORMATS)] = "",
    out: Path | None = None,
    overwrite: bool = False,
    profile: Literal["cpu", "warp"] = "cpu",
) -> CommandResult:
    """Write a scene in the formats of other tools.

    Args:
        scene: a folder made by `realsim reconstruct` or `realsim contact`.
        to: formats, separated by commas; or all. With --profile the default is mjcf.
        out: gets one folder per format; SCENE/export by default.
        overwrite: replace formats that an export wrote before.
        profile: of mjcf: for the CPU, or for MuJoCo Warp (the same as `--to warp`).
    """
    names = [name.strip() for name in to.split(",") if name.strip()]
    if profile == "warp":
        names = [("warp" if name == "mjcf" else name) for name in names or ["mjcf"]]
    if not names:
        raise RealsimError(
            "no format given", expected=f"--to all, or some of {', '.join(EXPORTERS)}, separated by commas"
        )
    written = export_scene(scene, names, out, overwrite=overwrite)
    lines = []
    for name, (first, *others) in written.items():
        more = f" and {len(others)} more file{'s' if len(others) > 1 else ''}" if others else ""
        lines.append(f"{name:<10} {first}{more}")
    lines += [f"{name:<10} left out: {reason}" for name, reason in written.skipped.items()]
    data: dict[str, Any] = {name: [str(p) for p in paths] for name, paths in written.items()}
    return CommandResult("\n".join(lines), data | ({"skipped": written.skipped} if written.skipped else {}))
