"""Errors that tell a person what to do.

Every error that a user can cause is a `RealsimError`: it names the file, what was expected, what was found and
what to do. The command line prints it without a traceback and exits with code 2.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unicodedata import category


def printable(text: str) -> str:
    """Text that a terminal shows as it is: control and format characters of names in files become escapes.

    An escape code in a file name could otherwise recolour, retitle or overwrite what the user reads; a change of
    writing direction could show another name than the file has. Line ends and tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(c if c in "\n\t" or category(c) not in ("Cc", "Cf", "Cs") else ascii(c)[1:-1] for c in text)


class RealsimError(Exception):
    """Base of all errors that a user can cause or mend.

    Args:
        message: one sentence that says what is wrong.
        file: the file or folder it is about.
        expected: what would have been right.
        found: what was there instead.
        hint: what to do about it.
    """

    usual_hint = "check that the file is whole and what the command takes (realsim help COMMAND), or give another one"
    """What to do where an error has nothing better; of a subclass for all errors of its kind."""

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        expected: str | None = None,
        found: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.expected, self.found, self.hint = expected, found, hint
        super().__init__(message)

    def __str__(self) -> str:
        return self._text(self.hint)

    def render(self) -> str:
        """The whole text, one fact per line, with what to do."""
        return self._text(self.hint or self.usual_hint)

    def _text(self, hint: str | None) -> str:
        facts = [("file", self.file), ("expected", self.expected), ("found", self.found), ("do", hint)]
        return printable("\n".join([self.message] + [f"  {name}: {value}" for name, value in facts if value]))

    def as_dict(self) -> dict[str, str | None]:
        """The same for machines (`--json`)."""
        return {
            "error": type(self).__name__,
            "message": self.message,
            "file": self.file,
            "expected": self.expected,
            "found": self.found,
            "hint": self.hint or self.usual_hint,
        }


def did_you_mean(name: str, known: Iterable[str], cutoff: float = 0.3) -> str | None:
    """A hint with the names most like `name`; None where nothing is (`cutoff` of difflib.get_close_matches)."""
    from difflib import get_close_matches  # not needed until something is wrong

    close = get_close_matches(name, list(known), n=3, cutoff=cutoff)
    return f"did you mean {' or '.join(close)}?" if close else None


def refuse_unknown(name: object, known: Iterable[str], message: str, file: str | Path | None) -> None:
    """Raise a GapError with this message for a name that is not known; the hint is the closest."""
    names = list(known)
    if name not in names:
        expected, hint = f"one of {', '.join(names[:40])}", did_you_mean(str(name), names)
        raise GapError(message, file=file, expected=expected, hint=hint)


class CaptureError(RealsimError):
    """The capture cannot be read, or holds nothing that can be used."""

    usual_hint = "mend, remove or record again what is named; realsim inspect CAPTURE shows the rest of the capture"


class PoseError(RealsimError):
    """Camera poses are unusable, or could not be estimated."""

    usual_hint = "give the frames without their poses (--ignore-poses), or record with more overlap between them"


class ModelError(RealsimError):
    """A model file does not fit the contract, cannot be run, or gives nothing that can be used."""

    usual_hint = "export the model again (docs/models.md says how it must be); realsim model inspect FILE checks it"


class ScaleError(RealsimError):
    """The metric scale cannot be determined, or frames disagree beyond the limit."""

    usual_hint = "record with a camera whose depth is metric, or give its unit with --depth-unit"


class AlignError(RealsimError):
    """No ground, no platform where one was requested, or contradictory directions."""

    usual_hint = "say where the way begins and ends: --start X Y --goal X Y"


class MeshError(RealsimError):
    """A mesh cannot be built, or a given one cannot be used."""

    usual_hint = "record the place again with more views, or give a mesh with triangles"


class ExportError(RealsimError):
    """A scene does not compile, step or hold what stands on it."""

    usual_hint = "make the scene or mesh again, without changes by hand; other --contact kinds may hold"


class GapError(RealsimError):
    """A robot log cannot support a diagnosis."""

    usual_hint = "docs/logs.md says what a case holds, realsim log RECORDING --model MODEL what was taken for what"


EXTRA_OF = {
    **dict.fromkeys(
        ("open3d", "cv2", "skimage", "fast_simplification", "manifold3d", "pymeshlab", "coacd", "onnxruntime"), "recon"
    ),
    **dict.fromkeys(("torch", "tensorboard", "onnx", "PIL"), "train"),
    "pycolmap": "colmap",
    "viser": "viewer",
    "pyrealsense2": "realsense",
    **dict.fromkeys(("OpenEXR", "lzfse"), "phone"),
    "laspy": "lidar",
    "pxr": "usd",
    "ray": "ray",
    "submitit": "slurm",
    "mcp": "mcp",
    **dict.fromkeys(("warp", "mujoco_warp"), "warp"),
    "rsl_rl": "rsl-rl",
    "robot_descriptions": "menagerie",
    "nicegui": "app",
}
"""Modules that a plain `pip install realsim` leaves out -> the extra that brings them."""


class MissingExtraError(RealsimError):
    """A package that belongs to an optional extra is not installed."""

    def __init__(self, package: str, extra: str, what: str) -> None:
        super().__init__(f"{what} needs the package {package}", hint=f'pip install "realsim[{extra}]"')


def extra(module: str, package_extra: str, what: str) -> Any:
    """The module of an optional extra, imported now. Raises MissingExtraError where it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(module, package_extra, what) from error


def require(name: str, what: str) -> None:
    """Refuse at once, before any work, what needs an extra of which a package is not installed.

    Args:
        name: the extra.
        what: what needs it, for the message.

    Raises:
        MissingExtraError: with the command that installs it.
    """
    for module, owner in EXTRA_OF.items():
        if owner == name and find_spec(module) is None:
            raise MissingExtraError(module, name, what)


@contextmanager
def explain_missing_packages(what: str) -> Iterator[None]:
    """Turn an import that fails for want of an extra into the message that says how to install it."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRA_OF:
            raise
        raise MissingExtraError(package, EXTRA_OF[package], what) from error


class UnknownNameError(RealsimError):
    """A name is not in a registry or a list; the message gives those that are, the closest first.

    Args:
        hint: what may help beside the closest names; otherwise: what to do where none is close.
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str], *, file: str | Path | None = None, hint: str | None = None,
        otherwise: str = "give one of these names",
    ) -> None:  # fmt: skip
        names = sorted(known)
        parts = name.split(",")
        close = did_you_mean(name, names, cutoff=0.5)
        if len(parts) > 1 and {*parts} <= {*names}:
            close = f"write them apart: {' '.join(parts)}"
        super().__init__(
            f"unknown {kind} {name!r}",
            file=file,
            expected=f"one of {', '.join(names)}",
            hint=" Or: ".join(filter(None, (close, hint))) or otherwise,
        )
