"""A job: one `realsim` command on one input, as a JSON file that says everything that its result depends on."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from realsim import __version__
from realsim.cli.commands import DO_NOT_USE
from realsim.core.errors import RealsimError
from realsim.core.files import digest

FORMAT = "realsim.job/1"
COMMANDS = ("inspect", "reconstruct", "contact", "export", "diagnose", "synth")
"""Commands that a job may run. A job file may come from somebody else: none of these opens a port, waits for a person,
runs code from a file, or writes elsewhere than to its output folder."""
CANCELLED: dict[str, Any] = {"error": "Cancelled", "message": "cancelled"}
"""Result of a job that was stopped before it was done."""


@dataclass(frozen=True)
class Job:
    """One item.

    Attributes:
        name: for people; of many items, no two have the same.
        command: one of COMMANDS.
        arguments: of the command, without `--json`.
        output: folder that the command is told to make; "" if it makes none.
        folders: what appears there whole, and is refused where it is there already: `output` itself, or parts of it.
        inputs: path -> fingerprint of the file or folder when the job was made.
        cwd: folder that relative paths in `arguments` start from.
        version: of realsim.
    """

    name: str
    command: str
    arguments: tuple[str, ...] = ()
    output: str = ""
    folders: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    cwd: str = field(default_factory=os.getcwd)
    version: str = __version__

    @property
    def key(self) -> str:
        """Name of the job's folder: a digest of all of the above, so that the same job has the same folder."""
        return digest(FORMAT, *asdict(self).items())[:32]

    def as_dict(self) -> dict[str, Any]:
        """As stored in job.json."""
        return {"format": FORMAT, **asdict(self)}

    @classmethod
    def read(cls, data: Any, key: str, file: Path) -> Job:
        """A job from job.json.

        Raises:
            RealsimError: it is damaged, changed, or not one that may be run.
        """
        try:
            if data.pop("format") != FORMAT:
                raise ValueError("another format")
            job = cls(
                **{
                    **data,
                    **{name: tuple(data[name]) for name in ("arguments", "folders")},
                    "inputs": dict(data["inputs"]),
                }
            )
            texts = (job.name, job.command, job.output, job.cwd, job.version, *job.arguments, *job.folders)
            if not all(isinstance(text, str) for text in (*texts, *job.inputs.values())):
                raise TypeError("not text")
            if job.key != key:
                raise ValueError("its content does not belong to its name: it was changed or damaged")
            if job.command not in COMMANDS:
                raise ValueError(f"the command {job.command!r}")
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise RealsimError(
                "the job file cannot be used",
                file=file,
                expected=f"{FORMAT} with one of the commands {', '.join(COMMANDS)}",
                found=str(error) or type(error).__name__,
                hint="submit the job again",
            ) from error
        return job

    def made(self) -> bool:
        """Whether what the command makes is there, or it makes nothing."""
        return not self.folders or any(Path(folder).exists() for folder in self.folders)

    def changed(self) -> list[str]:
        """Inputs that are no longer what they were when the job was made."""
        return [path for path, was in self.inputs.items() if fingerprint(Path(path), self.output) != was]


def make_job(command: str, source: Path, output: Path, options: Sequence[str] = (), parts: Sequence[str] = ()) -> Job:
    """The job `realsim COMMAND SOURCE --out OUTPUT OPTIONS`; its name is that of the output folder.

    Files that options name (a model, a policy) are inputs as well.

    Args:
        parts: names of the folders in `output` that the command makes, if it does not make `output` as a whole.
    """
    source, output = source.absolute(), output.absolute()
    values = [Path(option.rpartition("=")[2]).absolute() for option in options]
    inputs = [source, *(path for path in values if path.is_file())]
    return Job(
        output.name,
        command,
        (str(source), "--out", str(output), *options),
        str(output),
        tuple(str(output / part) for part in parts) or (str(output),),
        {str(path): fingerprint(path, str(output)) for path in inputs},
    )


def fingerprint(path: Path, without: str = "") -> str:
    """Digest of the names, sizes and times of change of a file, or of all files of a folder: no content is read.

    A terabyte of captures is submitted in seconds so; a copy counts as another input, which costs a second run at most.

    Args:
        without: a folder inside that does not count: the output, which may lie within its input.
    """
    if path.is_file():
        return digest(*_stamp(path))
    found = []
    for folder, inner, files in os.walk(path):
        inner[:] = sorted(name for name in inner if os.path.join(folder, name) != without)
        found += [(os.path.relpath(os.path.join(folder, f), path), *_stamp(Path(folder, f))) for f in sorted(files)]
    return digest(*found)


def _stamp(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:  # a broken link, or gone meanwhile: the command will say so
        return -1, -1
    return status.st_size, status.st_mtime_ns


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        name: of the job.
        exit_code: of the command; negative after a signal, 130 if it was cancelled.
        result: what the command printed with `--json`, an error's fields included.
        seconds: that it took.
        kept: it was there from an earlier run.
    """

    name: str
    exit_code: int
    result: dict[str, Any]
    seconds: float = 0.0
    kept: bool = False

    @property
    def ok(self) -> bool:
        """The output is there. Whether it should be used is its verdict's affair."""
        return self.exit_code in (0, DO_NOT_USE)
