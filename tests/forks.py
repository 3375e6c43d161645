"""`pytest --forks N`: what is collected is imported once, then N copies of the process run it, a file at a time.

Processes that start anew (pytest-xdist) each import and collect everything first: 10 s of computing each.
"""

import contextlib
import os
from collections.abc import Iterator
from importlib import import_module
from itertools import groupby
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any

import pytest

Files = list[list[pytest.Item]]
SOON = ("realsim.core.open3d", "trimesh", "scipy.interpolate", "torch._dynamo")
"""What many tests import within functions, in seconds each: all of the tests have it before the processes part."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--forks", type=int, default=0, help="processes that run the tests side by side")


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    config, forks = session.config, session.config.option.forks
    if not forks or config.option.collectonly or session.testsfailed:
        return None
    config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]  # one for all
    files = [list(group) for _, group in groupby(session.items, key=lambda item: item.path)]
    for name in SOON if len(files) > 100 else ():
        with contextlib.suppress(ImportError):
            import_module(name)
    todo, written = os.pipe()
    os.write(written, b"".join(k.to_bytes(2) for k in range(len(files))))
    os.close(written)
    workers: dict[Connection, tuple[int, str]] = {}
    try:
        for _ in range(min(forks, len(files))):
            ours, theirs = Pipe(duplex=False)
            if not (process := os.fork()):
                ours.close()
                _work(session, files, todo, theirs)
            theirs.close()
            workers[ours] = process, ""
        while workers and not session.shouldfail:
            for end in wait(list(workers)):
                assert isinstance(end, Connection)
                _hear(session, workers, end)
    finally:
        for process, _ in workers.values():
            os.kill(process, 15)
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    return True


def _hear(session: pytest.Session, workers: dict[Connection, tuple[int, str]], end: Connection) -> None:
    """What a worker says: the name of the test that it begins, a report, or nothing any more."""
    hook, (process, test) = session.config.hook, workers[end]
    try:
        said = end.recv()
    except EOFError:
        del workers[end]
        if not os.waitpid(process, 0)[1]:
            return
        test = test or __file__
        said = pytest.TestReport(test, (test, None, test), {}, "failed", "its process ended in it", "call")._to_json()
        said["$report_type"] = "TestReport"
    if isinstance(said, str):
        workers[end] = process, said
    else:
        report = hook.pytest_report_from_serializable(config=session.config, data=said)
        hook.pytest_runtest_logreport(report=report)


def _work(session: pytest.Session, files: Files, todo: int, end: Connection) -> None:
    """Runs files until none is left, and ends the process."""
    config = session.config

    class Reports:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            end.send(config.hook.pytest_report_to_serializable(config=config, report=report))

    code = 1
    try:
        capture: Any = config.pluginmanager.getplugin("capturemanager")
        capture.stop_global_capturing()  # into files that all would share
        capture.start_global_capturing()
        config.pluginmanager.unregister(name="terminalreporter")
        config.pluginmanager.register(Reports())
        items = _items(files, todo)
        item = next(items, None)
        while item is not None:
            end.send(item.nodeid)
            following = next(items, None)
            config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            item = following
        end.send("")
        code = 0
    finally:
        os._exit(code)


def _items(files: Files, todo: int) -> Iterator[pytest.Item]:
    while index := os.read(todo, 2):
        yield from files[int.from_bytes(index)]
