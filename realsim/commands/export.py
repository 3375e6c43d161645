"""`realsim export`: a scene in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from realsim.commands import CommandResult
from realsim.export import export_scene


def export(scene: Annotated[Path, tyro.conf.Positional], to: str, out: Path | None = None) -> CommandResult:
    """Write a scene folder in other formats.

    Args:
        scene: a folder that `realsim reconstruct` or `realsim contact` wrote.
        to: formats with commas between them: mjcf, warp, usd, urdf, sdf, terrain, glb, obj, stl, ply, heightmap.
        out: gets one folder a format; SCENE/export if not given.
    """
    names = [name.strip() for name in to.split(",") if name.strip()]
    files = export_scene(scene, names, out)
    lines = [f"{name:10s} {written[0]}" for name, written in files.items()]
    return CommandResult("\n".join(lines), {name: [str(p) for p in written] for name, written in files.items()})
