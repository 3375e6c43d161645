"""Other formats of a scene on disk; one small file each, one line in EXPORTERS.

An exporter is a function `(SceneOnDisk, folder) -> files it wrote`. It writes into `folder` only, the same bytes for
the same scene, metres and z up wherever the format leaves the choice.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from realsim import __version__
from realsim.core.errors import ExportError, MissingExtraError, explain_missing_packages
from realsim.core.files import edited_files, output_folder, read_json, refuse_existing, to_json, write_text
from realsim.core.progress import track
from realsim.core.registry import Registry
from realsim.export.formats.scene import SceneOnDisk, load_scene

__all__ = ["ALL", "EXPORTERS", "Exported", "SceneOnDisk", "export_scene", "load_scene"]

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
        "mjlab": "realsim.export.formats.mjlab:mjlab",
        "heightmap": "realsim.export.formats.heightmap:heightmap",
        "foxglove": "realsim.export.formats.foxglove:foxglove",
    },
    group="realsim.formats",
    of="collections.abc:Callable",
    otherwise="for Isaac Sim and Isaac Lab: usd; for Gazebo: sdf; docs/contact.md says what reads which",
)


ALL = "all"
"""In place of a list of names: every format."""
MARK = "export.json"
"""In every folder that an export wrote: which format, of which version, and what of the scene had been edited."""
REPORTS = ("report.json", "contact.json")


class Exported(dict[str, list[Path]]):
    """Format -> the files that were written."""

    skipped: Mapping[str, str]
    """With "all": format -> why it was left out (a package that is not installed)."""
    edited: tuple[str, ...]
    """Files of the scene that were changed since its report was written."""

    def __init__(
        self, written: Mapping[str, list[Path]], skipped: Mapping[str, str] | None = None, edited: Sequence[str] = ()
    ) -> None:
        super().__init__(written)
        self.skipped = dict(skipped or {})
        self.edited = tuple(edited)


def export_scene(scene: Path, to: str | Sequence[str], out: Path | None = None, *, overwrite: bool = False) -> Exported:
    """Write a scene folder in other formats, each of them whole or not at all.

    Args:
        scene: a folder that `realsim reconstruct` or `realsim contact` wrote.
        to: a name of EXPORTERS or several; or "all": every format whose packages are installed.
        out: gets one folder per format; `scene/export` if None.
        overwrite: replace formats that an export wrote before.

    Raises:
        UnknownNameError: no such format, before anything is written.
        MissingExtraError: a format requested by name needs a package that is not installed.
        RealsimError: no scene there, a format that is there already, or a file cannot be written.
    """
    names = [to] if isinstance(to, str) else list(to)
    if not names:
        raise ExportError("no format given", expected="to='all', or names of realsim.export.EXPORTERS")
    every = names == [ALL]
    exporters = {name: EXPORTERS[name] for name in (EXPORTERS if every else names)}
    loaded = load_scene(scene)
    report = next((read_json(scene / name) for name in REPORTS if (scene / name).is_file()), None)
    edited = edited_files(scene, report.get("files")) if isinstance(report, Mapping) else ()
    target = scene / "export" if out is None else out
    for name in exporters:
        refuse_existing(target / name, overwrite)
    written, skipped = {}, {}
    for name, exporter in track(exporters.items(), "formats"):
        try:
            with (
                explain_missing_packages(f"the format {name}"),
                output_folder(target / name, overwrite=overwrite) as folder,
            ):
                files = exporter(loaded, folder)
                if not files:
                    raise ExportError(f"the exporter of {name} gave no files back", expected="the paths that it wrote")
                write_text(folder / MARK, to_json({"format": name, "realsim": __version__, "edited": edited}))
        except MissingExtraError as error:
            if not every:
                raise
            skipped[name] = f"{error.message} ({error.hint})"
        else:
            written[name] = [target / name / path.relative_to(folder) for path in files]
    return Exported(written, skipped, edited)
