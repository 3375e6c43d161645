"""Many inputs on one machine or many, through one code path: jobs are folders (`queue`), workers take them
(`working`), executors start workers (`executors`).

Each item is a `realsim` command in a process of its own: a crash, exhausted memory or an exit code of one item can
never stop the others. The same job twice is done once; jobs of killed workers are taken over.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from realsim.core.errors import RealsimError
from realsim.core.files import refuse_existing
from realsim.core.progress import track
from realsim.jobs.executors import EXECUTORS, Executor, ManyConfig
from realsim.jobs.job import COMMANDS, Job, Outcome, make_job
from realsim.jobs.queue import Queue
from realsim.jobs.working import POLL, carry_out, run_key, work

__all__ = [
    "COMMANDS",
    "EXECUTORS",
    "FOLDER",
    "Executor",
    "Job",
    "ManyConfig",
    "Outcome",
    "Queue",
    "carry_out",
    "make_job",
    "run_key",
    "run_many",
    "work",
]
FOLDER = ".jobs"
"""Name of the folder of jobs in an output folder."""
LATE = 15.0
"""Seconds that the result of an ended job may need to become visible on a network file system."""
WAITING, RUNNING = "waiting", "running"


def run_many(jobs: Sequence[Job], queue: Queue, config: ManyConfig | None = None) -> list[Outcome]:
    """Have all jobs done; outcomes in their order. Interrupted, it cancels those that are not.

    A job whose output exists without a result of ours is refused, as its command would refuse it, unless it has
    `--overwrite`. Without `config.wait`, jobs that are not done have `waiting` or `running` as their result.
    """
    config = config or ManyConfig()
    names = [job.name for job in jobs]
    if len(set(names)) < len(names):
        twice = sorted({n for n in names if names.count(n) > 1})
        raise RealsimError(
            "two items would write to the same folder", found=", ".join(twice), hint="rename one of them"
        )
    done: dict[str, Outcome] = {}
    keys: dict[str, str] = {}
    for job in track(jobs, "submitting"):
        refused = _refused(job, queue)
        if refused is None:
            keys[queue.submit(job)] = job.name
        else:
            done[job.name] = refused
    executor = EXECUTORS[config.place](queue, config)
    kept = [key for key in keys if queue.result(key) is not None]
    try:
        executor.submit([key for key in keys if key not in kept])
        if config.wait:
            stream = _finished(queue, executor, dict(keys), kept)
            done |= {outcome.name: outcome for outcome in track(stream, "items", len(keys))}
        else:
            done |= {name: queue.result(key) or _pending(queue, key, name) for key, name in keys.items()}
    except BaseException:
        for key in keys:
            queue.cancel(key)
        executor.close()
        raise
    if config.wait:
        executor.close()
    return [done[name] for name in names]


def _refused(job: Job, queue: Queue) -> Outcome | None:
    """What the command would say of an output that is in its way; later attempts may not ask any more."""
    if "--overwrite" in job.arguments:
        return None
    earlier = queue.result(job.key)
    if (earlier is None and job.key in queue.all()) or (earlier is not None and earlier.ok):
        return None
    try:
        for folder in job.folders:
            refuse_existing(Path(folder), overwrite=False)
    except RealsimError as error:
        return Outcome(job.name, 2, dict(error.as_dict()))
    return None


def _pending(queue: Queue, key: str, name: str) -> Outcome:
    worker = queue.running(key)
    return Outcome(name, 0, {"state": WAITING} if worker is None else {"state": RUNNING, "worker": worker})


def _finished(queue: Queue, executor: Executor, waiting: dict[str, str], kept: Collection[str]) -> Iterator[Outcome]:
    """Outcomes as jobs are done; those that can have none are failures."""
    ended: dict[str, float] = {}
    while waiting:
        for key, name in list(waiting.items()):
            outcome = queue.result(key)
            if outcome is not None:
                outcome = replace(outcome, name=name, kept=key in kept)
            why = executor.lost(key) if outcome is None else None
            if why is not None and time.monotonic() - ended.setdefault(key, time.monotonic()) > LATE:
                outcome = Outcome(name, 1, {"error": "Crash", "message": why, "found": queue.tail(key)})
            if outcome is not None:
                del waiting[key]
                yield outcome
        time.sleep(POLL if waiting else 0)
