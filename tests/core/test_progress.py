"""The time that a job will still take, and the bars that show it."""

import io
import signal
from itertools import pairwise

import pytest
from rich.console import Console

from realsim.core import progress
from realsim.core.progress import TRUST, Remaining, steps, track, whole

USUAL = {"a": 10.0, "b": 30.0, "c": 20.0}


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("slower", [1.0, 2.0, 0.5])
def test_what_is_left_follows_the_pace_so_far(slower: float) -> None:
    clock = Clock()
    left = Remaining(USUAL, clock)
    assert left.seconds() == 60
    left.begin("a")
    clock.now += 10 * slower
    left.end()
    pace = (TRUST + 10 * slower) / (TRUST + 10)
    assert left.seconds() == pytest.approx(pace * 50)
    left.begin("b")
    clock.now += 5
    assert left.seconds() == pytest.approx(pace * 50 - 5)
    clock.now += 30 * slower - 5
    left.end()
    left.begin("c")
    left.end(kept=True)
    assert left.seconds() == 0


def test_what_was_kept_is_gone_and_tells_no_pace() -> None:
    left = Remaining(USUAL, Clock())
    for stage in ("a", "b"):
        left.begin(stage)
        left.end(kept=True)
    assert left.seconds() == 20


def test_a_stage_that_takes_too_long_makes_the_rest_longer() -> None:
    clock = Clock()
    left = Remaining(USUAL, clock)
    left.begin("a")
    told = []
    for _ in range(60):
        clock.now += 1
        told.append(left.seconds())
    assert told[:10] == [59 - k for k in range(10)]
    assert all(later > earlier for earlier, later in pairwise(told[10:]))


def test_stages_that_nobody_expects_take_nothing() -> None:
    left = Remaining({}, Clock())
    left.begin("more")
    left.end()
    assert left.seconds() == 0


def test_bars_of_stages_come_and_go_below_that_of_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(progress, "console", Console(file=screen, force_terminal=True, width=120))
    monkeypatch.setattr(progress, "_quiet", False)
    with whole("reconstruct", USUAL) as left:
        for stage in USUAL:
            left.begin(stage)
            for _ in track(range(3), f"part of {stage}"):
                with steps() as tick:
                    tick("deeper", 0.5)
            left.end()
    shown = screen.getvalue()
    assert "left: a" in shown
    assert "part of c" in shown
    assert "deeper" in shown


def test_progress_goes_to_a_function_as_long_as_it_listens() -> None:
    heard: list[tuple[str, float]] = []
    with progress.heard_by(lambda what, share: heard.append((what, share))):
        progress.note("begun")
        with progress.heard_by(None), whole("all", {"a": 1.0}) as left, steps() as tick:
            left.begin("a")
            tick("b", 0.5)
        assert list(track([1, 2], "c")) == [1, 2]
    progress.note("nobody listens")
    assert heard == [("begun", 0.0), ("a", 0.0), ("b", 0.5), ("c", 0.0), ("c", 0.5)]


def test_the_first_interrupt_asks_for_the_answer_so_far_and_the_second_ends() -> None:
    before = signal.signal(signal.SIGINT, progress.interrupt)
    try:
        with progress.answers_early():
            signal.raise_signal(signal.SIGINT)
            assert progress.stop_requested()
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert not progress.stop_requested()
    finally:
        signal.signal(signal.SIGINT, before)
        progress.forget_interrupt()


def test_what_an_interrupt_broke_is_the_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt), progress.broken_by_interrupt():
        try:
            progress.interrupt()
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
    with pytest.raises(ImportError), progress.broken_by_interrupt():
        raise ImportError
