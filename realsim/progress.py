"""Progress that a person can watch and a pipe does not see."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager, suppress
from typing import IO, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from realsim.errors import printable

T = TypeVar("T")
console = Console(stderr=True)
_quiet = False
_pipe: IO[str] | None = None
_last = ("", 0.0)
BETWEEN = 0.1
"""Seconds between two lines to a pipe about the same thing."""


def report_to(pipe: IO[str] | None) -> None:
    """Write progress to `pipe` as well, a JSON object {"what", "share"} a line; share is null if it is not known."""
    global _pipe
    _pipe = pipe


def _report(what: str, share: float | None) -> None:
    global _last
    if _pipe is None or (share is not None and _last[0] == what and time.monotonic() - _last[1] < BETWEEN):
        return
    _last = (what, time.monotonic())
    with suppress(OSError, ValueError):  # whoever listened has gone
        _pipe.write(json.dumps({"what": what, "share": share}) + "\n")
        _pipe.flush()


def set_quiet(quiet: bool) -> None:
    """Silence progress and notes (errors are still printed)."""
    global _quiet
    _quiet = quiet


def visible() -> bool:
    """Whether progress is shown: a terminal, and not asked to be quiet."""
    return not _quiet and console.is_terminal


def note(text: str) -> None:
    """A line for the person who watches."""
    _report(text, None)
    if visible():
        console.print(printable(text), style="dim", highlight=False, markup=False)


def track(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Iterate with a progress bar; without a terminal, just iterate."""
    if total is None and isinstance(items, Sized):
        total = len(items)
    if not visible():
        for done, item in enumerate(items):
            _report(what, done / total if total else None)
            yield item
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        for item in items:
            yield item
            bar.advance(task)


@contextmanager
def steps() -> Iterator[Callable[[str, float], None]]:
    """Yields a function to call with (what is being done, the share of it that is done) now and then.

    One bar a step, with the time that it has taken and the time that it will still take; steps that are done stay.
    Without a terminal, nothing is shown.
    """
    if not visible():
        yield _report
        return
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def tick(what: str, share: float) -> None:
            for name, task in tasks.items():
                if name != what:
                    bar.update(task, completed=1.0)
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=1.0)
            bar.update(tasks[what], completed=share)

        yield tick
