"""Which layout a capture has. Ambiguous or incomplete captures are reported, never guessed."""

from collections.abc import Mapping
from pathlib import Path

from realsim.capture.config import CaptureConfig
from realsim.capture.layout import Layout, Recognition
from realsim.core.errors import CaptureError, RealsimError

MAX_SUBFOLDERS = 200
NO_DEPTH = (
    "colour alone makes no scene: record with an app or camera that stores depth (docs/captures.md), or give the mesh "
    "that photogrammetry makes of pictures"
)
OTHER_CLOUDS = (".xyz", ".pts", ".ptx", ".asc", ".e57")
EXPORT = (
    "export the cloud as .ply, .pcd or .las, with normals if it has any (CloudCompare reads and writes all of them)"
)
LAST_RESORT = 1
"""Score of a layout that is only taken where nothing speaks for another one."""


def recognise(path: Path, name: str, layouts: Mapping[str, Layout]) -> tuple[Layout, Recognition]:
    """The layout requested by name, or for `auto` the one whose evidence is most specific.

    Raises:
        CaptureError: nothing there, no layout fits, something needed is missing, or two fit equally well.
        UnknownNameError: a name that is not in `layouts`.
    """
    if not path.exists():
        known = f"a folder with frames (layouts: {', '.join(layouts)}), a recording, or a scan"
        raise CaptureError("the capture does not exist", file=path, expected=known, hint="check the path")
    if not (path.is_dir() or path.is_file()):
        raise CaptureError("neither a file nor a folder", file=path, expected="a folder with frames, or a file")
    if path.is_dir() and not any(path.iterdir()):
        raise CaptureError("the folder is empty", file=path, expected="a folder with a capture in it")
    if name != "auto":
        return layouts[name], layouts[name].recognise(path)

    seen = {known: layout.recognise(path) for known, layout in layouts.items()}
    complete = {known: r for known, r in seen.items() if r.complete}
    # A mesh that lies in a broken capture must not be taken for it without a word.
    if any(r.missing and r.score > LAST_RESORT for r in seen.values()):
        complete = {known: r for known, r in complete.items() if r.score > LAST_RESORT}
    if not complete:
        raise _not_recognised(path, seen, layouts)
    top = max(r.score for r in complete.values())
    winners = [known for known, r in complete.items() if r.score == top]
    if len(winners) > 1:
        raise CaptureError(
            "the capture could be of several layouts",
            file=path,
            found="; ".join(f"{known}: {', '.join(complete[known].evidence)}" for known in winners),
            hint=" or ".join(f"--layout {known}" for known in winners),
        )
    return layouts[winners[0]], complete[winners[0]]


def _not_recognised(path: Path, seen: Mapping[str, Recognition], layouts: Mapping[str, Layout]) -> CaptureError:
    """The most helpful message: what the nearest layout lacks, or else what each one looks for."""
    partial = {known: r for known, r in seen.items() if r.missing}
    if partial:
        nearest = min(partial, key=lambda known: (len(partial[known].missing), -partial[known].score))
        missing = partial[nearest].missing
        no_depth = any(m.startswith("depth") for m in missing)
        headline = "colour without depth" if no_depth else "no " + missing[0].split(" (")[0]
        # Where intrinsics are missing, another layout would miss them too: the reader itself says what to write.
        camera = _hint_of_reader(layouts[nearest], path) if missing[0].startswith("intrinsics") else None
        others = [f"{known} would need {', '.join(r.missing)}" for known, r in partial.items() if known != nearest]
        last_resort = [f"--layout {known} reads {', '.join(r.evidence)}" for known, r in seen.items() if r.complete]
        return CaptureError(
            f"{headline}: the capture looks like layout {nearest}, but is incomplete",
            file=path,
            expected=", ".join(missing),
            found=", ".join(partial[nearest].evidence),
            hint=camera or "; ".join(others) or " or ".join(last_resort) or None,
        )
    return CaptureError(
        "no capture layout was recognised",
        file=path,
        expected="one of\n" + "\n".join(f"    {known}: {layout.looks_for}" for known, layout in layouts.items()),
        found=_what_is_there(path),
        hint=_subfolder_hint(path, layouts) or (EXPORT if path.suffix.lower() in OTHER_CLOUDS else NO_DEPTH),
    )


def _hint_of_reader(layout: Layout, path: Path) -> str | None:
    """What a layout itself says to do about an incomplete capture."""
    try:
        layout.read(path, CaptureConfig())
    except RealsimError as error:
        return error.hint
    return None


def _what_is_there(path: Path) -> str:
    if path.is_file():
        return f"a file {path.name}"
    names = sorted(p.name + ("/" if p.is_dir() else "") for p in path.iterdir())
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _subfolder_hint(path: Path, layouts: Mapping[str, Layout]) -> str | None:
    """People often name the folder above the capture: look two levels down and tell, but do not take it silently."""
    if not path.is_dir():
        return None
    folders = sorted(p for pattern in ("*", "*/*") for p in path.glob(pattern) if p.is_dir())[:MAX_SUBFOLDERS]
    found = [p for p in folders if any(layout.recognise(p).complete for layout in layouts.values())]
    return f"did you mean {' or '.join(map(str, found[:3]))}?" if found else None
