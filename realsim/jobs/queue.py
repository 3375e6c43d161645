"""Jobs in a folder that several machines may share: no server, nothing but files, and renames that succeed once.

    FOLDER/lease.json              how long a worker may be silent
    FOLDER/KEY/job.json            the job, never changed; KEY is its digest
    FOLDER/KEY/free.N              it waits, after N attempts; or
    FOLDER/KEY/held.N.WORKER       WORKER has it; the file's time is WORKER's last sign of life
    FOLDER/KEY/result.json         it is done, whatever else is there
    FOLDER/KEY/log.txt             what the command printed beside its result
    FOLDER/KEY/cancelled           it is to be stopped

A worker takes a job by renaming `free.N` or a `held.N.OTHER` whose time is too old: of many who try, one succeeds.
A worker that was only slow finds its file gone and stops. Should two run the same job all the same, nothing breaks:
outputs and results appear whole, and both are the result of the same job.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import tempfile
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from realsim.core.errors import RealsimError, printable
from realsim.core.files import explain_write_errors, place_folder, read_json, to_json, write_text
from realsim.jobs.job import CANCELLED, Job, Outcome

LEASE = 120.0
"""Seconds without a sign after which a worker is taken for dead. File times may reach other machines of a network file
system up to a minute late."""
ATTEMPTS = 3
"""Workers that may be lost on one job before it counts as failed: it may be the job that kills them."""


@dataclass(frozen=True)
class Claim:
    """A job that this worker holds."""

    key: str
    attempt: int
    ticket: Path

    @property
    def worker(self) -> str:
        """The machine and process that hold it."""
        return self.ticket.name.split(".")[2]


class Queue:
    """The jobs of a folder."""

    def __init__(self, folder: Path, lease: float = LEASE) -> None:
        """
        Args:
            folder: shared by all who submit and work.
            lease: seconds; only the one who makes the folder is asked.
        """
        self.folder = folder.absolute()
        self._lease_of_new = lease

    @property
    def lease(self) -> float:
        """Seconds of silence after which a worker loses its job."""
        with contextlib.suppress(RealsimError, KeyError, TypeError, ValueError):
            return float(read_json(self.folder / "lease.json")["seconds"])
        return self._lease_of_new

    # ------------------------------------------------------------ submitting

    def submit(self, job: Job) -> str:
        """Add a job and return its key; a job that waits, runs or is done already is left as it is.

        One that failed, or whose output is gone, is set to wait again.
        """
        key = job.key
        target = self.folder / key
        done = self.result(key)
        if done is not None:
            if done.ok and job.made():
                return key
            self._remove(key)
        with explain_write_errors(target):
            self.folder.mkdir(parents=True, exist_ok=True)
            if not (self.folder / "lease.json").exists():
                write_text(self.folder / "lease.json", to_json({"seconds": self._lease_of_new}))
            work = Path(tempfile.mkdtemp(dir=self.folder, prefix=".new-"))
            try:
                os.chmod(work, 0o755)
                write_text(work / "job.json", to_json(job.as_dict()))
                (work / "free.0").touch()
                place_folder(work, target)
            except RealsimError:  # somebody was faster with the same job
                shutil.rmtree(work)
        return key

    def _remove(self, key: str) -> None:
        """Take a finished job away; of several who try, one does."""
        old = Path(tempfile.mkdtemp(dir=self.folder, prefix=".old-"))
        with contextlib.suppress(FileNotFoundError):
            os.rename(self.folder / key, old / key)
        shutil.rmtree(old, ignore_errors=True)

    # ------------------------------------------------------------ looking

    def all(self) -> list[str]:
        """Keys of all jobs."""
        with contextlib.suppress(OSError), os.scandir(self.folder) as entries:
            return sorted(e.name for e in entries if _is_key(e.name) and e.is_dir(follow_symlinks=False))
        return []

    def job(self, key: str) -> Job:
        """A job, checked. Raises RealsimError for a damaged or forbidden one."""
        file = self.folder / key / "job.json"
        return Job.read(read_json(file), key, file)

    def result(self, key: str) -> Outcome | None:
        """What became of a job; None while it waits or runs."""
        file = self.folder / key / "result.json"
        if not file.exists():
            return None
        try:
            data = read_json(file)
            name, result = str(data["name"]), dict(data["result"])
            return Outcome(name, int(data["exit_code"]), result, float(data["seconds"]), kept=True)
        except (RealsimError, KeyError, TypeError, ValueError) as error:
            return Outcome(key, 1, {"error": "Damaged", "message": f"the result cannot be read: {error}"})

    def log(self, key: str) -> Path:
        """File with what the command printed beside its result; it may not be there."""
        return self.folder / key / "log.txt"

    def running(self, key: str) -> str | None:
        """The worker that has a job."""
        return next((name.split(".", 2)[2] for name in self._tickets(key) if name.startswith("held.")), None)

    def _tickets(self, key: str) -> list[str]:
        with contextlib.suppress(OSError):
            return [n for n in os.listdir(self.folder / key) if n.startswith(("free.", "held."))]
        return []

    # ------------------------------------------------------------ cancelling

    def cancel(self, key: str) -> None:
        """Stop a job: one that waits is over at once, one that runs when its worker looks, within a second or so."""
        if self.result(key) is not None:
            return
        with explain_write_errors(self.folder / key):
            (self.folder / key / "cancelled").touch()
        claim = self.claim(key)
        if claim is not None:
            self.finish(claim, Outcome(self._name(key), 130, CANCELLED))

    def cancelled(self, key: str) -> bool:
        """Whether a job is to be stopped."""
        return (self.folder / key / "cancelled").exists()

    def _name(self, key: str) -> str:
        with contextlib.suppress(RealsimError):
            return self.job(key).name
        return key

    # ------------------------------------------------------------ working

    def claim(self, key: str) -> Claim | None:
        """Take a job that waits, or that a dead worker had; None if there is nothing to take."""
        folder = self.folder / key
        if (folder / "result.json").exists():
            return None
        for name in self._tickets(key):
            kind, _, rest = name.partition(".")
            count, _, holder = rest.partition(".")
            if not count.isdigit() or (kind == "held" and not self._is_dead(folder / name, holder)):
                continue
            ticket = folder / f"held.{int(count) + 1}.{worker_name()}"
            with contextlib.suppress(OSError):
                os.rename(folder / name, ticket)
            # A network file system may report the failure of a rename that it repeated after it had succeeded.
            if ticket.exists():
                os.utime(ticket)
                return Claim(key, int(count) + 1, ticket)
        return None

    def _is_dead(self, ticket: Path, holder: str) -> bool:
        machine, _, process = holder.partition(".")[0].rpartition("-")
        if machine == _machine() and process.isdigit() and not _runs(int(process)):
            return True
        try:
            handle = os.open(ticket, os.O_RDONLY)  # opening asks a network file system for the present time of the file
        except OSError:
            return False
        try:
            return self._now() - os.fstat(handle).st_mtime > self.lease
        finally:
            os.close(handle)

    def _now(self) -> float:
        """The time of the machine that keeps the files: clocks of workers may differ."""
        with explain_write_errors(self.folder), tempfile.NamedTemporaryFile(dir=self.folder, prefix=".now-") as file:
            return os.fstat(file.fileno()).st_mtime

    def beat(self, claim: Claim) -> bool:
        """Give a sign of life; False if the job belongs to somebody else by now."""
        try:
            os.utime(claim.ticket)
        except OSError:
            return False
        return True

    def release(self, claim: Claim, *, counts: bool = False) -> None:
        """Give a job back unfinished. Without `counts` it was no attempt."""
        with contextlib.suppress(OSError):
            os.rename(claim.ticket, claim.ticket.with_name(f"free.{claim.attempt - (not counts)}"))

    def finish(self, claim: Claim, outcome: Outcome) -> None:
        """Store what became of a job, unless that is somebody else's by now."""
        if not claim.ticket.exists():
            return
        data = asdict(outcome) | {"format": "realsim.result/1", "attempt": claim.attempt, "worker": claim.worker}
        write_text(self.folder / claim.key / "result.json", to_json(data))
        with contextlib.suppress(OSError):
            claim.ticket.unlink()

    @contextlib.contextmanager
    def logging(self, key: str) -> Iterator[int]:
        """The log, open for appending: a file descriptor. A link in its place is not followed."""
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
        with explain_write_errors(self.log(key)):
            handle = os.open(self.log(key), flags, 0o644)
        try:
            yield handle
        finally:
            os.close(handle)

    def tail(self, key: str, most: int = 2000) -> str:
        """The end of the log."""
        with contextlib.suppress(OSError), self.log(key).open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - most))
            return printable(file.read(most).decode(errors="replace"))
        return ""


def _is_key(name: str) -> bool:
    return len(name) == 32 and set(name) <= set("0123456789abcdef")


@cache
def _machine() -> str:
    """This boot of this machine and this container in it: where process numbers mean something."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()[:8]
        return f"{boot}-{os.stat('/proc/self/ns/pid').st_ino}"
    except OSError:
        return f"{socket.gethostname().partition('.')[0]}-{uuid.getnode()}"


def worker_name() -> str:
    """A new name at each call. It tells machine and process; threads of one process also need names of their own."""
    return f"{_machine()}-{os.getpid()}.{uuid.uuid4().hex[:6]}"


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
