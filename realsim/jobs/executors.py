"""Where jobs are carried out. All executors do the same, `run_key(folder, key)`; they differ in the machine.

What became of a job is in its folder in any case, so an executor is three functions: start jobs, say which of them can
have no result any more, stop.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from realsim.core.errors import RealsimError, extra
from realsim.core.files import explain_write_errors, read_text, write_text
from realsim.jobs.queue import Queue
from realsim.jobs.working import run_key


@dataclass(frozen=True)
class ManyConfig:
    """Each gets a folder of its name below --out. One that fails stops no other."""

    jobs: int = 1
    """how many at a time on this machine, or at most at a time in a Slurm array."""
    executor: Literal["processes", "slurm", "ray", "worker"] = "processes"
    """where: here, in a Slurm array, on a Ray cluster, or wherever `realsim worker OUT` runs (docs/many.md)."""
    ray: str = ""
    """address of the Ray cluster: auto, or HOST:PORT. It must see the same paths."""
    slurm: str = ""
    """parameters of the Slurm jobs: partition=gpu,timeout_min=120,cpus_per_task=8,mem_gb=16."""
    wait: bool = True
    """with slurm or worker: --no-wait submits and returns; the same command again says how far they are."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise RealsimError("--jobs must be at least 1", found=str(self.jobs))
        if not self.wait and self.place in ("processes", "ray"):
            raise RealsimError(f"--no-wait would end the jobs of --executor {self.place}", expected="slurm or worker")

    @property
    def place(self) -> str:
        """The executor; an address of a Ray cluster says that it is Ray."""
        return "ray" if self.ray else self.executor


class Executor(Protocol):
    """Carries out jobs of a queue somewhere."""

    def submit(self, keys: Sequence[str]) -> None:
        """Start jobs; returns at once."""

    def lost(self, key: str) -> str | None:
        """Why a job without a result will never have one; None if it still may."""

    def close(self) -> None:
        """Let go of what was started; jobs that still run are stopped."""


class Processes:
    """On this machine, some at a time; the cores are shared among them."""

    def __init__(self, queue: Queue, config: ManyConfig) -> None:
        self.queue = queue
        self.threads = max(1, cores() // config.jobs) if config.jobs > 1 else None
        self.pool = ThreadPoolExecutor(config.jobs)
        self.stop = threading.Event()
        self.futures: dict[str, Future[None]] = {}

    def submit(self, keys: Sequence[str]) -> None:
        """See Executor."""
        for key in keys:
            self.futures[key] = self.pool.submit(run_key, str(self.queue.folder), key, self.threads, self.stop)

    def lost(self, key: str) -> str | None:
        """See Executor."""
        future = self.futures.get(key)
        if future is None or not future.done():
            return None
        return str(future.exception() or "it ended without a result")

    def close(self) -> None:
        """See Executor."""
        self.stop.set()
        self.pool.shutdown(cancel_futures=True)


class Workers:
    """Nothing is started: whoever runs `realsim worker` on the folder does the jobs."""

    def __init__(self, queue: Queue, config: ManyConfig) -> None:
        pass

    def submit(self, keys: Sequence[str]) -> None:
        """See Executor."""

    def lost(self, key: str) -> str | None:
        """See Executor. A lost worker's jobs are taken over by the others."""
        return None

    def close(self) -> None:
        """See Executor."""


class Slurm:
    """A Slurm array through submitit, which pickles the call `run_key(folder, key)` into a folder that is ours alone.

    What became of a job is never read from a pickle.
    """

    DEFAULTS: Mapping[str, Any] = {"name": "realsim", "timeout_min": 24 * 60}

    def __init__(self, queue: Queue, config: ManyConfig) -> None:
        submitit = extra("submitit", "slurm", "--executor slurm")
        self.queue = queue
        folder = queue.folder / "slurm"
        with explain_write_errors(folder):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder.chmod(0o700)
        given = _parameters(config.slurm)
        cluster = given.pop("cluster", "slurm")
        self.folder = folder / "%j"
        self.kind = submitit.LocalJob if cluster == "local" else submitit.SlurmJob
        try:
            self.executor = submitit.AutoExecutor(self.folder, cluster=cluster)
            self.executor.update_parameters(**{**self.DEFAULTS, "slurm_array_parallelism": config.jobs, **given})
        except (RuntimeError, ValueError, NameError, TypeError, AssertionError) as error:
            raise RealsimError("Slurm cannot be used so", found=str(error), hint="see --slurm") from error
        self.jobs: dict[str, Any] = {}

    def submit(self, keys: Sequence[str]) -> None:
        """See Executor. Jobs that an earlier command submitted, and that Slurm still has, are not submitted again."""
        self.jobs = {key: job for key in keys if (job := self._submitted(key)) is not None and not job.done()}
        new = [key for key in keys if key not in self.jobs]
        if not new:
            return
        try:
            jobs = self.executor.map_array(run_key, [str(self.queue.folder)] * len(new), new)
        except (OSError, RuntimeError, ValueError) as error:
            raise RealsimError("the jobs cannot be submitted to Slurm", found=str(error)) from error
        for key, job in zip(new, jobs, strict=True):
            self.jobs[key] = job
            write_text(self._number(key), job.job_id)

    def _number(self, key: str) -> Path:
        return self.queue.folder / key / "slurm.txt"

    def _submitted(self, key: str) -> Any:
        """The job of an earlier submission."""
        if not self._number(key).is_file():
            return None
        number = read_text(self._number(key), 100).strip()
        return self.kind(self.folder, number) if re.fullmatch(r"\d+(_\d+)?", number) else None

    def lost(self, key: str) -> str | None:
        """See Executor."""
        job = self.jobs.get(key)
        if job is None or not job.done():
            return None
        return f"Slurm job {job.job_id} ended as {job.state}; its log: {job.paths.stderr}"

    def close(self) -> None:
        """See Executor."""
        for job in self.jobs.values():
            if not job.done():
                job.cancel(check=False)


class Ray:
    """Tasks on a Ray cluster whose machines see the same paths."""

    def __init__(self, queue: Queue, config: ManyConfig) -> None:
        self.ray = extra("ray", "ray", "--ray")
        self.queue = queue
        self.mine = not self.ray.is_initialized()
        if self.mine:
            address = config.ray or "auto"
            _check_reachable(address)
            try:
                self.ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise RealsimError(
                    "no Ray cluster answers",
                    expected="a running cluster (ray start --head)",
                    found=f"{address}: {error}",
                ) from error
        self.task = self.ray.remote(max_retries=0)(run_key)
        self.refs: dict[str, Any] = {}

    def submit(self, keys: Sequence[str]) -> None:
        """See Executor."""
        self.refs |= {key: self.task.remote(str(self.queue.folder), key) for key in keys}

    def lost(self, key: str) -> str | None:
        """See Executor."""
        ref = self.refs.get(key)
        if ref is None or not self.ray.wait([ref], timeout=0)[0]:
            return None
        try:
            self.ray.get(ref)
        except Exception as error:  # of the task or of Ray: either way there is no result
            return f"the Ray worker was lost: {error}"
        return "the Ray task ended without a result"

    def close(self) -> None:
        """See Executor."""
        for key, ref in self.refs.items():
            if self.queue.result(key) is None:
                self.ray.cancel(ref, force=True)
        if self.mine:
            self.ray.shutdown()


EXECUTORS: Mapping[str, Callable[[Queue, ManyConfig], Executor]] = {
    "processes": Processes,
    "slurm": Slurm,
    "ray": Ray,
    "worker": Workers,
}


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _parameters(text: str) -> dict[str, Any]:
    """`partition=gpu,timeout_min=60` as submitit's parameters; those of Slurm alone get the prefix that it asks for."""
    common = ("name", "timeout_min", "mem_gb", "nodes", "cpus_per_task", "gpus_per_node", "cluster")
    found: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        name, equals, value = part.partition("=")
        if not equals:
            raise RealsimError("not a parameter", expected="--slurm NAME=VALUE,NAME=VALUE", found=part)
        number = float(value) if value.replace(".", "", 1).isdigit() else None
        found[name if name in common or name.startswith("slurm_") else f"slurm_{name}"] = (
            value if number is None else int(number) if number.is_integer() else number
        )
    return found


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
