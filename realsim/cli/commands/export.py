"""`realsim export`: a scene in other formats."""

from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import tyro

from realsim.cli.commands import CommandResult
from realsim.cli.commands.many import run_each
from realsim.core.errors import RealsimError
from realsim.core.recognise import whole
from realsim.export import ALL, EXPORTERS, export_scene
from realsim.jobs import ManyConfig
from realsim.results import describe_edited

FORMATS = f"{ALL}|{','.join(EXPORTERS)}"
"""What --help shows."""


def export(
    scenes: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE ...", help_behavior_hint="")
    ],
    to: Annotated[str, tyro.conf.arg(metavar=FORMATS)] = "",
    out: Path | None = None,
    overwrite: bool = False,
    profile: Literal["cpu", "warp"] = "cpu",
    many: ManyConfig = ManyConfig(),
) -> CommandResult:
    """Write a scene in the formats of other tools.

    Args:
        scenes: a folder made by `realsim reconstruct` or `realsim contact`; or several.
        to: formats, separated by commas; or all. With --profile the default is mjcf.
        out: gets one folder per format (with several scenes in a folder of their name); SCENE/export by default.
        overwrite: replace formats that an export wrote before.
        profile: of mjcf: for the CPU, or for MuJoCo Warp (the same as `--to warp`).
    """
    names = [name.strip() for name in to.split(",") if name.strip()]
    if profile == "warp":
        names = [("warp" if name == "mjcf" else name) for name in names or ["mjcf"]]
    if not names:
        raise RealsimError(
            "no format given",
            expected=f"--to all, or some of {', '.join(EXPORTERS)}, separated by commas",
            hint=f"realsim export {quote(str(scenes[0])) if scenes else 'SCENE'} --to usd,urdf",
        )
    if not scenes:
        raise RealsimError("no scene given", expected="realsim export SCENE --to FORMATS")
    scenes = tuple(whole(scene) for scene in scenes)
    if len(scenes) > 1 or many.place != "processes":
        place = None if out is not None else lambda scene: scene / "export"
        parts = list(EXPORTERS) if names == [ALL] else names
        return run_each(
            "export", scenes, out or scenes[0].resolve().parent, many, shows="folder", place=place, parts=parts
        )
    (scene,) = scenes
    written = export_scene(scene, names, out, overwrite=overwrite)
    lines = []
    for name, (first, *others) in written.items():
        more = f" and {len(others)} more file{'s' if len(others) > 1 else ''}" if others else ""
        lines.append(f"{name:<10} {first}{more}")
    lines += [f"{name:<10} left out: {reason}" for name, reason in written.skipped.items()]
    if written.edited:
        lines.append(f"note       {describe_edited(written.edited)}")
    data = {
        "folder": str(out or scene / "export"),
        "formats": {name: [str(p) for p in paths] for name, paths in written.items()},
        "skipped": written.skipped,
        "edited": list(written.edited),
    }
    return CommandResult("\n".join(lines), data)
