"""A `realsim` command that runs in a process of its own, with its progress and its result."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.cli.child import PARENT, PROGRESS
from realsim.core.errors import printable

GRACE = 20.0
"""Seconds that a cancelled command gets to clean up."""


@dataclass
class Work:
    """One command, as the page shows it. It runs once `run` is awaited."""

    title: str
    arguments: tuple[str, ...]
    out: Path | None = None
    """The folder that it writes."""
    state: str = "waiting"
    """waiting, running, done, failed or cancelled."""
    step: str = ""
    """What is being done."""
    share: float | None = None
    """The share of the step that is done, 0..1, where it is known."""
    left: float | None = None
    """Seconds that the whole will still take, where that is known."""
    began: float = 0.0
    seconds: float = 0.0
    steps: list[str] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)
    """What the command prints with --json; of a failure: message, file, expected, found, hint."""
    _process: asyncio.subprocess.Process | None = None

    @property
    def ended(self) -> bool:
        return self.state in ("done", "failed", "cancelled")

    async def run(self) -> None:
        """Run it to its end. A failure is a state, not an exception."""
        self.state, self.began = "running", time.monotonic()
        reading, writing = os.pipe()
        environment = dict(os.environ) | {PARENT: str(os.getpid()), PROGRESS: str(writing)}
        try:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "realsim.cli.child", *self.arguments, "--json",
                stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
                pass_fds=(writing,), env=environment,
            )  # fmt: skip
        finally:
            os.close(writing)
        pipe = asyncio.StreamReader()
        loop = asyncio.get_running_loop()
        transport, _ = await loop.connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(pipe), os.fdopen(reading, "rb")
        )
        listening = asyncio.create_task(self._listen(pipe))
        try:
            out, err = await self._process.communicate()
        except asyncio.CancelledError:
            await self.cancel()
            raise
        finally:
            listening.cancel()
            transport.close()
            self.seconds = time.monotonic() - self.began
        self._conclude(out, err)

    async def cancel(self) -> None:
        """End the command; what it had not finished is not left behind."""
        if self._process is None or self._process.returncode is not None:
            return
        self.state = "cancelled"
        with suppress(ProcessLookupError):
            self._process.terminate()
        try:
            await asyncio.wait_for(self._process.wait(), GRACE)
        except TimeoutError:
            self._process.kill()
            await self._process.wait()

    async def _listen(self, pipe: asyncio.StreamReader) -> None:
        while line := await pipe.readline():
            with suppress(ValueError, KeyError, TypeError):
                self.hear(json.loads(line))

    def hear(self, report: dict[str, Any]) -> None:
        """Take in a line of progress: {"what", "share"} and, of some commands, {"left"}."""
        what = str(report["what"])
        if what != self.step:
            self.step = what
            self.steps.append(what)
        self.share = None if report["share"] is None else min(max(float(report["share"]), 0.0), 1.0)
        if "left" in report:
            self.left = float(report["left"])

    def _conclude(self, out: bytes, err: bytes) -> None:
        try:
            self.result = dict(json.loads(out))
        except ValueError:
            end = printable(err[-2000:].decode(errors="replace"))
            code = self._process.returncode if self._process else None
            self.result = {"error": "no result", "message": f"the command ended with exit code {code}", "found": end}
        if self.state != "cancelled":
            self.state = "failed" if "error" in self.result else "done"


def command_line(arguments: Sequence[str]) -> str:
    """The command as a person would type it."""
    import shlex

    return shlex.join(["realsim", *arguments])
