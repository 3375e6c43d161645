"""Progress that a person can watch and a pipe does not see."""

import json
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import IO, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from realsim.core.errors import printable

T = TypeVar("T")
console = Console(stderr=True)
_quiet = False
_pipe: IO[str] | None = None
_listener: Callable[[str, float], None] | None = None
_last = ("", 0.0)
_interrupted = _early = False
BETWEEN = 0.1
"""Seconds between two lines to a pipe about the same thing."""


def report_to(pipe: IO[str] | None) -> None:
    """Write progress to `pipe` as well, a JSON object {"what", "share"} a line; share is null if it is not
    known. A job of several stages also gives "left", the seconds that it will still take, where a stage begins."""
    global _pipe
    _pipe = pipe


@contextmanager
def heard_by(listener: Callable[[str, float], None] | None) -> Iterator[None]:
    """Progress goes to a function, with what is being done and the share of it that is done, instead of a terminal."""
    global _listener
    before, _listener = _listener, listener or _listener
    try:
        yield
    finally:
        _listener = before


def interrupt(*_: object) -> None:
    """Handler of a signal: ends what runs by KeyboardInterrupt, at the next progress if a package swallows it, as some
    do while they are imported."""
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt


@contextmanager
def answers_early() -> Iterator[None]:
    """The first Ctrl-C of a person within asks for the answer so far (`stop_requested`), the second ends what runs."""
    global _early

    def ask(*_: object) -> None:
        global _early
        if _early:
            interrupt()
        _early = True
        note("ending with the answer so far; interrupt again to end without one")

    if signal.getsignal(signal.SIGINT) != interrupt:  # no command of ours runs
        yield
        return
    signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        _early = False
        signal.signal(signal.SIGINT, interrupt)


def stop_requested() -> bool:
    """Whether a person wants the answer so far."""
    return _early


def forget_interrupt() -> None:
    """A command begins."""
    global _interrupted
    _interrupted = False


@contextmanager
def broken_by_interrupt() -> Iterator[None]:
    """What fails within after an interrupt is the interrupt: some packages raise an error of their own of it while they
    are imported."""
    try:
        yield
    except Exception:
        _end_if_interrupted()
        raise


def _end_if_interrupted() -> None:
    if _interrupted:
        forget_interrupt()
        raise KeyboardInterrupt


def _report(what: str, share: float | None, left: float | None = None) -> None:
    global _last
    _end_if_interrupted()
    if _listener is not None:
        _listener(what, share or 0.0)
    if _pipe is None or (share is not None and _last[0] == what and time.monotonic() - _last[1] < BETWEEN):
        return
    _last = (what, time.monotonic())
    with suppress(OSError, ValueError):  # whoever listened has gone
        more = {} if left is None else {"left": round(left, 1)}
        _pipe.write(json.dumps({"what": what, "share": share} | more) + "\n")
        _pipe.flush()


def set_quiet(quiet: bool) -> None:
    """Silence progress and notes (errors are still printed)."""
    global _quiet
    _quiet = quiet


def visible() -> bool:
    """Whether progress is shown: a terminal, and not asked to be quiet."""
    return not _quiet and _listener is None and console.is_terminal


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
            _end_if_interrupted()
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
            _end_if_interrupted()
            for name, task in tasks.items():
                if name != what:
                    bar.update(task, completed=1.0)
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=1.0)
            bar.update(tasks[what], completed=share)

        yield tick


TRUST = 10.0
"""Seconds of usual work that a job's own pace must have been seen for until it counts half."""


class Remaining:
    """The time that a job of several stages will still take.

    What its stages usually take, times how much slower (or faster) the stages so far have been than usual.
    """

    def __init__(self, usual: Mapping[str, float], clock: Callable[[], float] = time.monotonic) -> None:
        """`usual`: stage -> seconds, in any order. A stage that is not among them counts for nothing."""
        self.waiting = dict(usual)
        self.clock = clock
        self.stage, self.usual, self.began = "", 0.0, clock()
        self.seen, self.took = 0.0, 0.0

    def begin(self, stage: str) -> None:
        """A stage begins; the one before has ended."""
        self.stage, self.usual, self.began = stage, self.waiting.pop(stage, 0.0), self.clock()
        _report(stage, None, self.seconds())

    def end(self, kept: bool = False) -> None:
        """The stage has ended. `kept`: its result was there already, which tells nothing about the pace."""
        if self.usual and not kept:
            self.seen, self.took = self.seen + self.usual, self.took + self.clock() - self.began
        self.stage, self.usual = "", 0.0

    def seconds(self) -> float:
        """How many it will still take."""
        now = self.clock() - self.began if self.usual else 0.0
        pace = (TRUST + self.took) / (TRUST + self.seen)
        if now > pace * self.usual:  # it has taken longer than it should: so will the rest
            pace = (TRUST + self.took + now) / (TRUST + self.seen + self.usual)
        return max(pace * self.usual - now, 0.0) + pace * sum(self.waiting.values())


class _Whole(ProgressColumn):
    """The time that the job as a whole will still take."""

    max_refresh = 0.5

    def __init__(self, remaining: Remaining) -> None:
        super().__init__()
        self.remaining = remaining

    def render(self, task: Task) -> Text:
        left = self.remaining.seconds()
        task.completed = (task.elapsed or 0.0) / max((task.elapsed or 0.0) + left, 1e-9)
        return Text(f"about {timedelta(seconds=round(left))} left: {self.remaining.stage}", style="progress.remaining")


@contextmanager
def whole(what: str, usual: Mapping[str, float]) -> Iterator[Remaining]:
    """One bar for a job of several stages, below which those of its stages come and go.

    Args:
        usual: stage -> seconds that it usually takes; see Remaining, which is yielded and must be told of each stage.
    """
    remaining = Remaining(usual)
    if not visible():
        yield remaining
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), _Whole(remaining))
    with Progress(*columns, console=console, transient=True) as bar:
        bar.add_task(what, total=1.0)
        yield remaining
