"""Other formats of a scene on disk; one small file each, one line in EXPORTERS.

An exporter is a function `(SceneOnDisk, folder) -> files it wrote`. It writes into `folder` only, the same bytes for
the same scene, metres and z up wherever the format leaves the choice.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from realsim.export.formats.scene import SceneOnDisk, load_scene
from realsim.files import explain_write_errors
from realsim.registry import Registry

__all__ = ["EXPORTERS", "SceneOnDisk", "export_scene", "load_scene"]

EXPORTERS = Registry(
    "format",
    {
        "mjcf": "realsim.export.formats.mjcf:mjcf",
        "warp": "realsim.export.formats.mjcf:warp",
        "usd": "realsim.export.formats.usd:usd",
        "urdf": "realsim.export.formats.urdf:urdf",
        "sdf": "realsim.export.formats.sdf:sdf",
        "terrain": "realsim.export.formats.terrain:terrain",
        "glb": "realsim.export.formats.meshes:glb",
        "obj": "realsim.export.formats.meshes:obj",
        "stl": "realsim.export.formats.meshes:stl",
        "ply": "realsim.export.formats.meshes:ply",
        "heightmap": "realsim.export.formats.heightmap:heightmap",
    },
)


def export_scene(scene: Path, to: Sequence[str], out: Path | None = None) -> dict[str, list[Path]]:
    """Write a scene folder in other formats.

    Args:
        scene: a folder that `realsim reconstruct` or `realsim contact` wrote.
        to: names of EXPORTERS.
        out: gets one folder a format; `scene/export` if None.

    Returns:
        {format: files written}.

    Raises:
        UnknownNameError: no such format, before anything is written.
        RealsimError: no scene there, or a file cannot be written.
    """
    exporters = {name: EXPORTERS[name] for name in to}
    loaded = load_scene(scene)
    target = scene / "export" if out is None else out
    return {name: _written(exporter, loaded, target / name) for name, exporter in exporters.items()}


def _written(exporter: Callable[[SceneOnDisk, Path], list[Path]], scene: SceneOnDisk, folder: Path) -> list[Path]:
    """Files of one format: written elsewhere first, so that a failure leaves `folder` as it was."""
    with explain_write_errors(folder):
        existed = folder.parent.is_dir()
        folder.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.partial-"))
    try:
        made = [path.relative_to(work) for path in exporter(scene, work)]
        with explain_write_errors(folder):
            for name in made:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(work / name, folder / name)
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not existed:
            with contextlib.suppress(OSError):
                folder.parent.rmdir()  # only where nothing came into it
    return [folder / name for name in made]
