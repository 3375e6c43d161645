"""A job: one `realsim` command on one input, in a process of its own: no crash of one can stop the others.

FOLDER/NAME-KEY/log.txt        what the command printed beside its result; it was begun
FOLDER/NAME-KEY/result.json    what became of it
"""

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any

from realsim import __version__
from realsim.cli.child import PARENT
from realsim.cli.commands import DO_NOT_USE
from realsim.cli.started import GRACE, MOST_OUTPUT, answer_of, command_line
from realsim.core.errors import RealsimError
from realsim.core.files import digest, explain_write_errors, read_json, refuse_existing, to_json, write_text

POLL = 0.3
"""Seconds between two looks at a running command."""


@dataclass(frozen=True)
class Job:
    """One item.

    Attributes:
        name: for people; of many items, no two have the same.
        command: of `realsim`.
        arguments: of the command, without `--json`.
        folders: what it makes, each whole or not at all; refused where it is there already.
        inputs: path -> fingerprint of the file or folder when the job was made.
        cwd: folder that relative paths in `arguments` start from.
        version: of realsim.
    """

    name: str
    command: str
    arguments: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    cwd: str = field(default_factory=os.getcwd)
    version: str = __version__

    @property
    def key(self) -> str:
        """Name of the job's folder; the same job has the same."""
        return f"{self.name[:40]}-{digest(*asdict(self).items())[:12]}"

    @property
    def command_line(self) -> list[str]:
        """What is run."""
        return command_line([self.command, *self.arguments])


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        name: of the job.
        exit_code: of the command; negative after a signal.
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
        tuple(str(output / part) for part in parts) or (str(output),),
        {str(path): fingerprint(path, str(output)) for path in inputs},
    )


def fingerprint(path: Path, without: str = "") -> str:
    """Digest of the names, sizes and times of change of a file, or of all files of a folder: no content is read.

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


def find_outcome(job: Job, folder: Path) -> Outcome | None:
    """What became of a job whose result is kept: it is done and its output still there, or its output is in the way."""
    place = folder / job.key
    there = [Path(made).exists() for made in job.folders]
    try:
        earlier = Outcome(**{**read_json(place / "result.json"), "name": job.name, "kept": True})
    except (RealsimError, TypeError):  # none, or damaged: it is done again
        earlier = None
    if earlier is not None and earlier.ok and (any(there) or not there):
        return earlier
    if "--overwrite" in job.arguments or _interrupted(place):
        return None
    try:
        for made in job.folders:
            refuse_existing(Path(made), overwrite=False)
    except RealsimError as error:
        return Outcome(job.name, 2, dict(error.as_dict()))
    return None


def _interrupted(place: Path) -> bool:
    """Whether a job was begun and nobody could say what became of it."""
    return (place / "log.txt").exists() and not (place / "result.json").exists()


def carry_out(job: Job, folder: Path, threads: int | None = None, stop: threading.Event | None = None) -> Outcome:
    """Run a job to its end, and store what became of it.

    Args:
        folder: of all jobs.
        threads: that numeric libraries may use; as the environment says if None.
        stop: ends the job early; nothing is stored then.
    """
    began, place = time.monotonic(), folder / job.key
    if _interrupted(place) and job.folders and "--overwrite" not in job.arguments:
        job = replace(job, arguments=(*job.arguments, "--overwrite"))  # what it finds there is its own
    with explain_write_errors(place):
        place.mkdir(parents=True, exist_ok=True)
        (place / "result.json").unlink(missing_ok=True)
        log = (place / "log.txt").open("wb")
    with log, tempfile.TemporaryFile() as out:
        code = _run(job, out, log, threads, stop)
        out.seek(0)
        result = answer_of(out.read(MOST_OUTPUT + 1), (place / "log.txt").read_bytes(), code)
    outcome = Outcome(job.name, code, result, round(time.monotonic() - began, 3))
    if stop is None or not stop.is_set():
        write_text(place / "result.json", to_json(asdict(outcome)))
    return outcome


def _run(job: Job, out: IO[bytes], log: IO[bytes], threads: int | None, stop: threading.Event | None) -> int:
    """The exit code of a job's command."""
    environment = dict(os.environ, PYTHONUNBUFFERED="1", **{PARENT: str(os.getpid())})
    if threads is not None:
        environment |= {"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    process = subprocess.Popen(
        job.command_line, stdout=out, stderr=log, stdin=subprocess.DEVNULL, env=environment, cwd=job.cwd
    )
    try:
        while stop is None or not stop.is_set():
            try:
                return process.wait(POLL)
            except subprocess.TimeoutExpired:
                continue
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(GRACE)
            except subprocess.TimeoutExpired:
                process.kill()
    return process.wait()
