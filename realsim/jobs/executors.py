"""Where jobs are carried out: an executor starts `carry_out` for each job, here or on another machine."""

import logging
import os
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from realsim.core.errors import RealsimError, extra
from realsim.core.files import explain_write_errors
from realsim.jobs.job import Job, Outcome, carry_out


@dataclass(frozen=True)
class ManyConfig:
    """Each gets a folder of its name below --out. One that fails stops no other."""

    jobs: int = 1
    """how many at a time on this machine, or at most at a time in a Slurm array."""
    executor: Literal["processes", "slurm", "ray"] = "processes"
    """where: here, in a Slurm array, or on a Ray cluster (docs/many.md)."""
    ray: str = ""
    """address of the Ray cluster: auto, or HOST:PORT. It must see the same paths."""
    slurm: str = ""
    """parameters of the Slurm jobs: partition=gpu,timeout_min=120,cpus_per_task=8,mem_gb=16."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise RealsimError("--jobs must be at least 1", expected="1 or more", found=str(self.jobs))

    @property
    def place(self) -> str:
        """The executor; an address of a Ray cluster says that it is Ray."""
        return "ray" if self.ray else self.executor


class Future(Protocol):
    """What concurrent.futures, submitit and Ray have in common."""

    def done(self) -> bool: ...
    def result(self) -> Outcome: ...


class Executor(Protocol):
    """Carries out jobs somewhere."""

    def submit(self, jobs: Sequence[Job]) -> Sequence[Future]:
        """Start jobs; returns at once."""

    def close(self) -> None:
        """Let go of what was started; jobs that still run are stopped."""


class Processes:
    """On this machine, some at a time; the cores are shared among them."""

    def __init__(self, folder: Path, config: ManyConfig) -> None:
        self.folder = folder
        self.threads = max(1, cores() // config.jobs) if config.jobs > 1 else None
        self.pool = ThreadPoolExecutor(config.jobs)
        self.stop = threading.Event()

    def submit(self, jobs: Sequence[Job]) -> Sequence[Future]:
        """See Executor."""
        return [self.pool.submit(carry_out, job, self.folder, self.threads, self.stop) for job in jobs]

    def close(self) -> None:
        """See Executor."""
        self.stop.set()
        self.pool.shutdown(cancel_futures=True)


class Slurm:
    """A Slurm array through submitit, which pickles calls and results into a folder that is ours alone."""

    DEFAULTS: Mapping[str, Any] = {"name": "realsim", "timeout_min": 24 * 60}

    def __init__(self, folder: Path, config: ManyConfig) -> None:
        submitit = extra("submitit", "slurm", "--executor slurm")
        self.folder = folder
        own = folder / "slurm"
        with explain_write_errors(own):
            own.mkdir(mode=0o700, parents=True, exist_ok=True)
            own.chmod(0o700)
        given = read_parameters(config.slurm)
        try:
            self.executor = submitit.AutoExecutor(own / "%j", cluster=given.pop("cluster", "slurm"))
            self.executor.update_parameters(**{**self.DEFAULTS, "slurm_array_parallelism": config.jobs, **given})
        except (RuntimeError, ValueError, NameError, TypeError, AssertionError) as error:
            raise RealsimError("Slurm cannot be used so", found=str(error), hint="see --slurm") from error
        self.jobs: list[Any] = []

    def submit(self, jobs: Sequence[Job]) -> Sequence[Future]:
        """See Executor."""
        try:
            self.jobs = self.executor.map_array(carry_out, jobs, [self.folder] * len(jobs)) if jobs else []
        except (OSError, RuntimeError, ValueError) as error:
            raise RealsimError(
                "the jobs cannot be submitted to Slurm", expected="a Slurm that takes --slurm", found=str(error)
            ) from error
        return self.jobs

    def close(self) -> None:
        """See Executor."""
        for job in self.jobs:
            if not job.done():
                job.cancel(check=False)


class Ray:
    """Tasks on a Ray cluster whose machines see the same paths."""

    def __init__(self, folder: Path, config: ManyConfig) -> None:
        self.ray = extra("ray", "ray", "--ray")
        self.folder = folder
        self.mine = not self.ray.is_initialized()
        if self.mine:
            address = config.ray or "auto"
            _check_reachable(address)
            try:
                self.ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise _no_cluster(address, error) from error
        self.refs: list[Any] = []

    def submit(self, jobs: Sequence[Job]) -> Sequence[Future]:
        """See Executor."""
        task = self.ray.remote(max_retries=0)(carry_out)
        self.refs = [task.remote(job, self.folder) for job in jobs]
        return [ref.future() for ref in self.refs]

    def close(self) -> None:
        """See Executor."""
        for ref in self.refs:
            self.ray.cancel(ref, force=True)
        if self.mine:
            self.ray.shutdown()


EXECUTORS: Mapping[str, Callable[[Path, ManyConfig], Executor]] = {
    "processes": Processes,
    "slurm": Slurm,
    "ray": Ray,
}


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def read_parameters(text: str) -> dict[str, Any]:
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
        raise _no_cluster(address, error) from error


def _no_cluster(address: str, error: Exception) -> RealsimError:
    expected = "a running cluster (ray start --head)"
    return RealsimError("no Ray cluster answers", expected=expected, found=f"{address}: {error}")
