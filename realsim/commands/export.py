"""`realsim export`: a scene in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from realsim.commands import CommandResult
from realsim.errors import RealsimError
from realsim.export import EXPORTERS, export_scene


def export(scene: Annotated[Path, tyro.conf.Positional], to: str = "", out: Path | None = None) -> CommandResult:
    """Write a scene in the formats of other tools: mjcf, warp, usd, urdf, sdf, terrain, glb, obj, stl, ply, heightmap.

    Args:
        scene: a folder made by `realsim reconstruct` or `realsim contact`.
        to: formats, separated by commas.
        out: gets one folder a format; SCENE/export if not given.
    """
    names = [name.strip() for name in to.split(",") if name.strip()]
    if not names:
        raise RealsimError("no format given", expected=f"--to with some of {', '.join(EXPORTERS)}, separated by commas")
    written = export_scene(scene, names, out)
    files = {name: [str(p) for p in paths] for name, paths in written.items()}
    return CommandResult("\n".join(f"{name:<10} {path}" for name, paths in files.items() for path in paths), files)
