"""Progress that a person can watch and a pipe does not see."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TypeVar

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


def set_quiet(quiet: bool) -> None:
    """Silence progress and notes (errors are still printed)."""
    global _quiet
    _quiet = quiet


def visible() -> bool:
    """Whether progress is shown: a terminal, and not asked to be quiet."""
    return not _quiet and console.is_terminal


def note(text: str) -> None:
    """A line for the person who watches."""
    if visible():
        console.print(printable(text), style="dim", highlight=False, markup=False)


def track(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Iterate with a progress bar; without a terminal, just iterate."""
    if not visible():
        yield from items
        return
    if total is None and isinstance(items, Sized):
        total = len(items)
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
        yield lambda what, share: None
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
