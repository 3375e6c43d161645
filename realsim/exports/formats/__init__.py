"""Other formats of a scene on disk; one small file each, one line in EXPORTERS.

An exporter is a function `(SceneOnDisk, folder) -> files it wrote`. It writes into `folder` only, the same bytes for
the same scene, metres and z up wherever the format leaves the choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from realsim.exports.formats.scene import SceneOnDisk, load_scene
from realsim.registry import Registry

__all__ = ["EXPORTERS", "SceneOnDisk", "export_scene", "load_scene"]

EXPORTERS = Registry(
    "format",
    {
        "mjcf": "realsim.exports.formats.mjcf:mjcf",
        "warp": "realsim.exports.formats.mjcf:warp",
        "usd": "realsim.exports.formats.usd:usd",
        "urdf": "realsim.exports.formats.urdf:urdf",
        "sdf": "realsim.exports.formats.sdf:sdf",
        "terrain": "realsim.exports.formats.terrain:terrain",
        "glb": "realsim.exports.formats.meshes:glb",
        "obj": "realsim.exports.formats.meshes:obj",
        "stl": "realsim.exports.formats.meshes:stl",
        "ply": "realsim.exports.formats.meshes:ply",
        "heightmap": "realsim.exports.formats.heightmap:heightmap",
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
    return {name: exporter(loaded, target / name) for name, exporter in exporters.items()}
