"""Carrying jobs out: each in a process of its own, with signs of life while it runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from realsim.cli.child import PARENT
from realsim.core.errors import RealsimError
from realsim.jobs.job import CANCELLED, Job, Outcome
from realsim.jobs.queue import ATTEMPTS, Claim, Queue

POLL = 0.3
"""Seconds between two looks at a running job, or at a folder in which nothing is to be done now."""
BEATS = 8
"""Signs of life in the time after which a worker is taken for dead."""
GRACE = 20.0
"""Seconds that a command gets to stop and clean up before it is killed."""
INTERRUPTED = 130
"""Exit code of a command that was asked to stop."""
MOST_OUTPUT = 64 * 2**20
"""Bytes that a command may print as its result."""


def carry_out(queue: Queue, claim: Claim, threads: int | None = None, stop: threading.Event | None = None) -> None:
    """Run a job that was claimed to its end and store what became of it.

    Whatever happens, the job is left done, or free for others, or belongs to somebody else.

    Args:
        threads: that numeric libraries may use; as the environment says if None.
        stop: ends the job early; it is free for others then.
    """
    began = time.monotonic()
    try:
        outcome = _outcome(queue, claim, threads, stop)
        if outcome is not None:
            name, code, result = outcome
            queue.finish(claim, Outcome(name, code, result, round(time.monotonic() - began, 3)))
    finally:
        queue.release(claim)  # nothing is left to be given back if it was finished


def _outcome(
    queue: Queue, claim: Claim, threads: int | None, stop: threading.Event | None
) -> tuple[str, int, dict[str, object]] | None:
    """Name, exit code and result of a job; None if it was ended early and is not done."""
    try:
        job = queue.job(claim.key)
    except RealsimError as error:
        return claim.key, 2, dict(error.as_dict())
    if queue.cancelled(claim.key):
        return job.name, INTERRUPTED, CANCELLED
    if claim.attempt > ATTEMPTS:
        message = f"{ATTEMPTS} workers were lost while they had this job"
        return job.name, 1, {"error": "Crash", "message": message, "found": queue.tail(claim.key)}
    changed = job.changed()
    if changed:
        stale = RealsimError("the input has changed since the job was made", file=changed[0], hint="submit it again")
        return job.name, 2, dict(stale.as_dict())

    def ended() -> bool:
        return (stop is not None and stop.is_set()) or queue.cancelled(claim.key) or not claim.ticket.exists()

    with tempfile.TemporaryFile() as out, queue.logging(claim.key) as log:
        code = _run(command(job, claim), job.cwd, out, log, threads, ended, _beating(queue, claim))
        if code is None:
            return (job.name, INTERRUPTED, CANCELLED) if queue.cancelled(claim.key) else None
        if code == INTERRUPTED:  # not by us: the machine is going down, or memory was short
            queue.release(claim, counts=True)
            return None
        return job.name, code, _printed(out, code, queue.tail(claim.key))


def command(job: Job, claim: Claim) -> list[str]:
    """The command line of a job.

    A job is only made if its output may be written. What a later attempt finds there is that of an attempt whose worker
    was lost before it could say so.
    """
    again = ["--overwrite"] if claim.attempt > 1 and job.folders and "--overwrite" not in job.arguments else []
    return [sys.executable, "-m", "realsim.cli.child", job.command, *job.arguments, *again, "--json"]


def _beating(queue: Queue, claim: Claim) -> Callable[[], None]:
    """A function that gives a sign of life if it is time for one."""
    interval, last = queue.lease / BEATS, [time.monotonic()]

    def beat() -> None:
        if time.monotonic() - last[0] > interval:
            last[0] = time.monotonic()
            queue.beat(claim)

    return beat


def _run(
    arguments: list[str],
    cwd: str,
    out: IO[bytes],
    log: int,
    threads: int | None,
    ended: Callable[[], bool],
    beat: Callable[[], None],
) -> int | None:
    """The exit code of a command; None if `ended` told it to stop."""
    environment = dict(os.environ, PYTHONUNBUFFERED="1", **{PARENT: str(os.getpid())})
    if threads is not None:
        environment |= {"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    place = cwd if Path(cwd).is_dir() else None
    process = subprocess.Popen(arguments, stdout=out, stderr=log, stdin=subprocess.DEVNULL, env=environment, cwd=place)
    try:
        while True:
            try:
                return process.wait(POLL)
            except subprocess.TimeoutExpired:
                if ended():
                    return None
                beat()
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(GRACE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _printed(out: IO[bytes], code: int, log: str) -> dict[str, object]:
    """What a command printed with `--json`, or that it printed nothing of the kind."""
    out.seek(0)
    text = out.read(MOST_OUTPUT + 1)
    try:
        result = json.loads(text) if len(text) <= MOST_OUTPUT else None
    except ValueError:
        result = None
    if isinstance(result, dict):
        return result
    what = f"killed by signal {-code}" if code < 0 else "ended without a result"
    return {"error": "Crash", "message": f"the process {what}", "found": log}


def run_key(folder: str, key: str, threads: int | None = None, stop: threading.Event | None = None) -> None:
    """See to it that one job is done: carry it out, or wait for whoever has it. What executors call, anywhere."""
    queue = Queue(Path(folder))
    while queue.result(key) is None and not (stop is not None and stop.is_set()):
        claim = queue.claim(key)
        if claim is None:
            time.sleep(POLL)
        else:
            carry_out(queue, claim, threads, stop)


def work(
    queue: Queue,
    *,
    idle: float = 0.0,
    threads: int | None = None,
    tell: Callable[[int, int, Outcome | None], None] = lambda done, total, outcome: None,
) -> list[Outcome]:
    """Carry out jobs of a folder until all are done, by whomever; returns what became of those done here.

    Args:
        idle: seconds to wait for further jobs when all are done.
        threads: that numeric libraries may use in a job.
        tell: called with (jobs done, all jobs, what became of the last one here) when something has changed.
    """
    mine: list[Outcome] = []
    finished: set[str] = set()
    since = time.monotonic()
    while True:
        keys = queue.all()
        finished &= set(keys)
        for key in (k for k in keys if k not in finished):
            claim = queue.claim(key)
            if claim is not None:
                carry_out(queue, claim, threads)
                outcome = queue.result(key)
                mine += [outcome] if outcome is not None else []
                tell(len(finished) + 1, len(keys), outcome)
                since = time.monotonic()
            if (queue.folder / key / "result.json").exists():
                finished.add(key)
        if len(finished) < len(keys):
            since = time.monotonic()
        elif time.monotonic() - since >= idle and set(queue.all()) <= finished:
            return mine
        time.sleep(POLL)
