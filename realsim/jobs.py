"""Many captures or cases at once, on one machine or on a Ray cluster, through one code path.

Each item is a `realsim` command of its own in a process of its own: a crash, an exhausted memory or an exit code of
one item can never stop the others. Locally, N of them run side by side; with Ray, the same function is a remote task.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from realsim.errors import MissingExtraError, RealsimError
from realsim.progress import track


@dataclass(frozen=True)
class Job:
    """One item: a name for people, and the arguments of the `realsim` command (without `--json`)."""

    name: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job. `result` is the command's `--json` output; for an error, its fields."""

    name: str
    exit_code: int
    result: dict[str, Any]

    @property
    def ok(self) -> bool:
        return self.exit_code == 0


def run_job(job: Job, threads: int | None = None) -> Outcome:
    """Run one job to its end in a process of its own and read what it printed.

    Args:
        threads: threads that numeric libraries may use in it; all cores if None.
    """
    environment = dict(os.environ, PYTHONUNBUFFERED="1")
    if threads is not None:
        environment |= {"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    command = [sys.executable, "-m", "realsim", *job.arguments, "--json"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        _running.add(process)
        try:
            out, err = process.communicate()
        finally:
            _running.discard(process)
    try:
        result = json.loads(out)
    except json.JSONDecodeError:
        what = f"killed by signal {-process.returncode}" if process.returncode < 0 else "ended without a result"
        result = {"error": "Crash", "message": f"the process {what}", "found": err[-2000:]}
    return Outcome(job.name, process.returncode, result)


def run_many(jobs: Sequence[Job], *, workers: int = 1, ray_address: str | None = None) -> list[Outcome]:
    """Run all jobs, at most `workers` at a time here, or on a Ray cluster; outcomes in the order of the jobs.

    Args:
        ray_address: `auto`, `local`, or `HOST:PORT` of a Ray cluster whose machines see the same paths.
    """
    if workers < 1:
        raise RealsimError("--jobs must be at least 1", found=str(workers))
    names = [job.name for job in jobs]
    if len(set(names)) < len(names):
        twice = sorted({n for n in names if names.count(n) > 1})
        raise RealsimError(
            "two items would write to the same folder", found=", ".join(twice), hint="rename one of them"
        )
    stream = _on_ray(jobs, ray_address) if ray_address else _here(jobs, workers)
    done = {outcome.name: outcome for outcome in track(stream, "items", len(jobs))}
    return [done[name] for name in names]


_running: set[subprocess.Popen[str]] = set()


def _here(jobs: Sequence[Job], workers: int) -> Iterator[Outcome]:
    threads = max(1, (os.cpu_count() or 1) // workers) if workers > 1 else None
    stop = threading.Event()

    def work(job: Job) -> Outcome:
        if stop.is_set():
            return Outcome(job.name, 130, {"error": "Interrupted", "message": "not started"})
        return run_job(job, threads)

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            stop.set()
            for process in list(_running):
                process.terminate()
            raise


def _on_ray(jobs: Sequence[Job], address: str) -> Iterator[Outcome]:
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "--ray") from error
    with ExitStack() as stack:
        if not ray.is_initialized():
            _check_reachable(address)
            try:
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise RealsimError(
                    "no Ray cluster answers",
                    expected="a running cluster (ray start --head)",
                    found=f"{address}: {error}",
                ) from error
            stack.callback(ray.shutdown)
        remote = ray.remote(max_retries=0)(run_job)
        waiting = {remote.remote(job): job for job in jobs}
        while waiting:
            (ready, *_), _ = ray.wait(list(waiting), num_returns=1)
            job = waiting.pop(ready)
            try:
                yield ray.get(ready)
            except ray.exceptions.RayError as error:
                yield Outcome(job.name, 1, {"error": "Crash", "message": f"the Ray worker was lost: {error}"})


def _check_reachable(address: str) -> None:
    """Ray itself waits minutes for a cluster that is not there."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():
        return
    try:
        socket.create_connection((host, int(port)), timeout=5).close()
    except OSError as error:
        raise RealsimError(
            "no Ray cluster answers", expected="a running cluster (ray start --head)", found=f"{address}: {error}"
        ) from error
