"""What a file or folder is, told by its names and first bytes, and which command takes it.

For messages: whoever gives a folder of CSVs to `realsim diagnose` is told of `realsim log`. Nothing is read beyond a
few names and the head of a file; readers decide for themselves what they can read.
"""

import functools
import inspect
import os
import re
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import ParamSpec, TypeVar

from realsim.core.errors import MissingExtraError, RealsimError, UnknownNameError, did_you_mean

P = ParamSpec("P")
T = TypeVar("T")
LOOKED_AT = 2000
"""Names in a folder that are looked at: a capture of an hour has more."""
HEAD = 4096
"""Bytes of a file that are looked at."""


@dataclass(frozen=True)
class Kind:
    """A kind of input."""

    name: str
    what: str
    """As one says what was found."""
    next: str
    """What can be done with it; `{path}` is its path."""

    def way_out(self, path: Path) -> str:
        """What can be done with this one."""
        return self.next.format(path=shlex.quote(str(path)))


_LOG = "realsim diagnose {path} --model robot.xml; realsim log {path} --model robot.xml --out case makes a case of it"
KINDS = {
    kind.name: kind
    for kind in (
        Kind("case", "a case: a robot's log and its model", "realsim diagnose {path} --out diagnosis"),
        Kind("diagnosis", "a finished diagnosis", "open {path}/report.html, or realsim excite {path} --out experiment"),
        Kind("experiment", "an experiment to record", "follow {path}/README.md; realsim diagnose CASE {path} uses it"),
        Kind("scene", "a reconstructed scene", "realsim view {path}, realsim export {path} --to all, or finetune it"),
        Kind(
            "contact scene",
            "a mesh with collision geometry, which has no start and goal to walk between",
            "realsim export {path} --to all; to train on it: realsim reconstruct MESH --out scene with the mesh itself",
        ),
        Kind("training run", "a training run", "realsim evaluate SCENE --policy {path}/policy.pt"),
        Kind(
            "synthetic capture", "a synthetic capture with its truth", "realsim reconstruct {path}/capture --out scene"
        ),
        Kind("capture", "a folder of frames", "realsim reconstruct {path} --out scene"),
        Kind("bag", "a recording of messages", f"{_LOG}; or, if it holds a depth camera, realsim reconstruct {{path}}"),
        Kind("recording", "a robot's recording", _LOG),
        Kind("scan", "a scan", "realsim reconstruct {path} --out scene"),
        Kind(
            "mesh",
            "a mesh",
            "realsim contact {path} for its collision geometry, or realsim reconstruct {path} for a scene to walk in",
        ),
        Kind(
            "model",
            "a model in MJCF or URDF",
            "realsim robot new {path} for a robot, realsim lint {path} for what terrain in it collides as; with a "
            "recording realsim log RECORDING --model {path} --out case makes a case, realsim diagnose --init {path} "
            "--out case an empty one",
        ),
        Kind(
            "network",
            "a network",
            "realsim deploy {path} or realsim diagnose CASE --policy {path} for a policy, realsim model inspect {path} "
            "for one that makes depth",
        ),
        Kind(
            "checkpoint",
            "a policy as it was trained",
            "realsim evaluate SCENE --policy {path}; realsim deploy takes the policy.onnx beside it",
        ),
        Kind(
            "video", "a video, which has no depth", "record with an app or camera that stores depth (docs/captures.md)"
        ),
        Kind("picture", "a single picture", "give the folder of a whole capture, with depth (docs/captures.md)"),
        Kind("archive", "an archive", "unpack {path}, and give the folder"),
        Kind(
            "CAD file", "a file of a CAD or scene program", "export it as .glb, .obj or .stl, then realsim contact FILE"
        ),
        Kind("text", "a text", "give a folder of frames, a scan, a mesh, a recording or a case (realsim --help)"),
        Kind("empty folder", "an empty folder", "check the path: nothing is in {path}"),
    )
}
MARKS = {
    "log.json": "case",
    "diagnosis.json": "diagnosis",
    "experiment.json": "experiment",
    "report.json": "scene",
    "contact.json": "contact scene",
    "history.jsonl": "training run",
    "truth/truth.json": "synthetic capture",
    "transforms.json": "capture",
    "metadata.yaml": "bag",
    "meta/info.json": "recording",
}
"""A file that a folder of a kind has, the surest first."""
PARTS = ("scene.xml", "report.html", *(name for name in MARKS if "/" not in name))
"""Files that stand for the folder that they are in."""
ENDINGS = {
    "bag": ".mcap .bag .db3",
    "recording": ".csv .parquet .ulg .ulog .rrd .jsonl .npz .tsv .log .lvm",
    "scan": ".ply .pcd .las .laz .xyz .pts",
    "mesh": ".stl .obj .glb .gltf .off",
    "capture": ".r3d",
    "network": ".onnx",
    "checkpoint": ".pt .pth .ckpt",
    "video": ".mp4 .mov .avi .mkv .webm",
    "picture": ".png .jpg .jpeg .tif .tiff .exr .heic .pgm .depth .bmp",
    "archive": ".zip .tar .gz .tgz .7z .xz .rar .zst",
    "CAD file": ".fbx .dae .blend .step .stp .iges .usd .usda .usdc .usdz .3mf .sdf .splat .spz .e57 .skp",
    "text": ".txt .md .json .yaml .yml .html .pdf .toml .py .ipynb",
}
_KIND_OF = {ending: kind for kind, endings in ENDINGS.items() for ending in endings.split()}


def recognise(path: Path) -> Kind | None:
    """The kind of a file or folder; None if nothing tells, or it is not there."""
    try:
        name = _folder(path) if path.is_dir() else _file(path) if path.is_file() else None
    except (OSError, ValueError):  # not ours to read, a zero byte in the name
        return None
    return None if name is None else KINDS[name]


def whole(path: Path) -> Path:
    """The folder that a file like `scene.xml` or `report.html` stands for; the path itself otherwise."""
    if path.name in PARTS and path.is_file() and _marked(path.parent) is not None:
        return path.parent
    return path


def _marked(folder: Path) -> str | None:
    return next((kind for mark, kind in MARKS.items() if (folder / mark).is_file()), None)


def _folder(folder: Path) -> str | None:
    marked = _marked(folder)
    if marked is not None:
        return marked
    names = list(islice(_names(folder), LOOKED_AT))
    if not names:
        return "empty folder"
    kinds = [_KIND_OF.get(Path(name).suffix.lower()) for name in names]
    # Pictures make a capture even where tables (poses, the inertial sensor) lie beside them.
    for kind, becomes in (("picture", "capture"), ("bag", "bag"), ("recording", "recording")):
        if kind in kinds:
            return becomes
    return next((kind for kind in kinds if kind in ("scan", "mesh", "model", "network")), None)


def _names(folder: Path, depth: int = 3) -> Iterator[str]:
    """Names of files, those of the folder first; of links to folders none."""
    below = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if entry.is_dir(follow_symlinks=False):
                below.append(Path(entry.path))
            else:
                yield entry.name
    for inner in sorted(below) if depth > 1 else ():
        yield from _names(inner, depth - 1)


def _file(path: Path) -> str | None:
    if whole(path) != path:
        return _marked(path.parent)
    with path.open("rb") as file:
        head = file.read(HEAD).lstrip(b"\xef\xbb\xbf \t\r\n")
    if head.startswith(b"<") and any(tag in head for tag in (b"<mujoco", b"<robot")):
        return "model"
    return _KIND_OF.get(path.suffix.lower())


def explain(error: RealsimError, path: Path, takes: Collection[str]) -> bool:
    """Complete an error about an input that is of another kind than a command takes, or is not there.

    Args:
        takes: names of the kinds that it takes.

    Returns:
        Whether this is what is wrong.
    """
    if not _exists(path):
        about = error.file is not None and Path(error.file).is_relative_to(path)
        if re.match("[a-z0-9]+:/", str(path)):
            error.hint = "download it first: files and folders of this machine are read"
        elif error.hint in (None, "check the path"):
            absent = "check the path: it is not there" if about else error.hint
            error.hint = did_you_mean(path.name, _siblings(path), cutoff=0.6) or absent
        return False
    kind = recognise(path)
    if kind is not None and kind.name == "mesh" and path.is_dir() and tuple(takes) == TAKES["meshes"]:
        error.found, error.hint = "a folder of meshes", f"name its files: {shlex.quote(str(path))}/*"
        return True
    if kind is None or kind.name in takes:
        return False
    error.file = error.file or str(path)
    error.found = f"{kind.what}" + (
        f" ({error.found})" if error.found not in (None, "", kind.what) and len(error.found) < 80 else ""
    )
    error.hint = kind.way_out(whole(path))
    return True


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return True  # there is more to it than a wrong name


def _siblings(path: Path) -> list[str]:
    try:
        return sorted(os.listdir(path.absolute().parent))[:LOOKED_AT]
    except (OSError, ValueError):
        return []


TAKES = {
    **dict.fromkeys(("frames", "capture"), ("capture", "scan", "mesh", "bag")),
    **dict.fromkeys(("mesh", "meshes"), ("mesh", "scan")),
    **dict.fromkeys(("scene", "scenes"), ("scene", "contact scene")),
    **dict.fromkeys(("case", "cases", "since"), ("case", "experiment")),
    "source": ("case", "diagnosis"),
    "recording": ("recording", "bag", "text"),
    **dict.fromkeys(("model", "init"), ("model",)),
    "file": ("network",),
    "mjcf": ("model", "scene", "contact scene"),
}
"""Parameter -> the kinds of input that it takes. A name means the same in all commands and functions of the API."""


def explain_inputs(function: Callable[P, T], takes: Mapping[str, Collection[str]] = TAKES) -> Callable[P, T]:
    """A function whose errors about an input of another kind than it takes say what it is, and what takes it."""

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except (MissingExtraError, UnknownNameError):  # whatever was given; an option's name is no input's fault
            raise
        except RealsimError as error:
            given = inspect.signature(function).bind_partial(*args, **kwargs).arguments
            inputs = [(n, p) for n, v in given.items() for p in (v if isinstance(v, tuple) else (v,))]
            paths = [(n, p) for n, p in inputs if isinstance(p, str | os.PathLike) and str(p)]
            # Of many, the one that the error is about, unless it is a file of unknown kind that is not there.
            about = [(n, p) for n, p in paths if str(p) == error.file and (n in takes or _exists(Path(p)))] or paths
            for name, path in ((n, p) for n, p in about if n in takes):
                recordings = TAKES["recording"] if given.get("model") is not None else ()  # with --model they are taken
                if explain(error, Path(path), (*takes[name], *recordings)):
                    break
            raise

    return called
