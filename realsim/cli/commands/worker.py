"""`realsim worker`: does the jobs of a folder that several machines share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.errors import RealsimError
from realsim.core.progress import note
from realsim.jobs import FOLDER, Outcome, Queue, work


def worker(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    idle: float = 0.0,
    threads: int | None = None,
    cancel: bool = False,
) -> CommandResult:
    """Do jobs of a folder, one at a time, until all are done; start as many workers as you like, on any machine.

    A job that a worker was killed with is taken over by another. Use folders that only people you trust can write to:
    a job is a `realsim` command with files of its author's choice. See docs/many.md.

    Args:
        folder: --out of a command with several inputs, or the folder .jobs in it.
        idle: seconds to wait for further jobs when all are done, or for the first.
        threads: that a job may use; as OMP_NUM_THREADS says, else all cores.
        cancel: do none; stop those that run and drop those that wait.
    """
    place = folder if folder.name == FOLDER else folder / FOLDER
    queue = Queue(place)
    if not idle and not place.is_dir():
        raise RealsimError(
            "there are no jobs", file=place, hint="submit some: realsim reconstruct A B --out OUT --executor worker"
        )
    if cancel:
        keys = [key for key in queue.all() if queue.result(key) is None]
        for key in keys:
            queue.cancel(key)
        return CommandResult(f"{len(keys)} jobs cancelled", {"cancelled": len(keys)})

    def tell(done: int, total: int, outcome: Outcome | None) -> None:
        if outcome is not None:
            note(f"{done} of {total}: {outcome.name} {'done' if outcome.ok else 'failed'} in {outcome.seconds:.0f} s")

    done = work(queue, idle=idle, threads=threads, tell=tell)
    failed = sum(not outcome.ok for outcome in done)
    items = [{"name": o.name, "exit_code": o.exit_code, "seconds": o.seconds} for o in done]
    said = f"{len(done)} job{'' if len(done) == 1 else 's'} done here" + (
        f", {failed} of them failed" if failed else ""
    )
    text = f"{said}; none is left in {place}"
    return CommandResult(text, {"items": items, "failed": failed})
