"""Many inputs: a process pool here, a Slurm array, or a Ray cluster."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from realsim.core.errors import RealsimError
from realsim.core.progress import track
from realsim.jobs.executors import EXECUTORS, Executor, Future, ManyConfig
from realsim.jobs.job import POLL, Job, Outcome, carry_out, find_outcome, make_job

__all__ = ["EXECUTORS", "FOLDER", "Executor", "Job", "ManyConfig", "Outcome", "carry_out", "make_job", "run_many"]
FOLDER = ".jobs"
"""Name of the folder of jobs in an output folder."""


def run_many(jobs: Sequence[Job], folder: Path, config: ManyConfig | None = None) -> list[Outcome]:
    """Have all jobs done; outcomes in their order. Interrupted, it stops those that run.

    What is done already is kept. A job whose output exists without a result of ours is refused, as its command would
    refuse it, unless it has `--overwrite`.

    Args:
        folder: of logs and results.
    """
    config = config or ManyConfig()
    names = [job.name for job in jobs]
    if len(set(names)) < len(names):
        twice = sorted({n for n in names if names.count(n) > 1})
        raise RealsimError(
            "two items would write to the same folder", found=", ".join(twice), hint="rename one of them"
        )
    done = {job.name: found for job in jobs if (found := find_outcome(job, folder)) is not None}
    waiting = [job for job in jobs if job.name not in done]
    executor = EXECUTORS[config.place](folder, config)
    try:
        futures = executor.submit(waiting)
        finished = _as_completed({job.name: future for job, future in zip(waiting, futures, strict=True)})
        done |= {outcome.name: outcome for outcome in track(finished, "items", len(waiting))}
    finally:
        executor.close()
    return [done[name] for name in names]


def _as_completed(waiting: dict[str, Future]) -> Iterator[Outcome]:
    """Outcomes as jobs are done; a job that was lost with its machine is a failure."""
    while waiting:
        for name in [name for name, future in waiting.items() if future.done()]:
            try:
                yield waiting.pop(name).result()
            except RealsimError as error:
                yield Outcome(name, 2, dict(error.as_dict()))
            except Exception as error:  # of submitit, of Ray, or of the machine: either way there is no result
                message = f"the job was lost: {str(error) or type(error).__name__}"
                yield Outcome(name, 1, {"error": "Crash", "message": message})
        time.sleep(POLL if waiting else 0)
