"""A `realsim` command that runs in a process of its own, with its progress and its result."""

import asyncio
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.cli.started import answer_of, end, started


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
    """Seconds that the whole will still take, where that is known, from `heard` on."""
    heard: float = 0.0
    began: float = 0.0
    seconds: float = 0.0
    steps: list[str] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)
    """What the command prints with --json; of a failure: message, file, expected, found, hint."""
    _process: asyncio.subprocess.Process | None = None

    @property
    def ended(self) -> bool:
        return self.state in ("done", "failed", "cancelled")

    def remaining(self) -> float | None:
        """`left` less the time since it was heard; None once that has passed."""
        seconds = 0.0 if self.left is None else self.left - (time.monotonic() - self.heard)
        return seconds if seconds >= 1 else None

    async def run(self) -> None:
        """Run it to its end. A failure is a state, not an exception."""
        self.state, self.began = "running", time.monotonic()
        try:
            async with started(self.arguments, self.hear) as self._process:
                out, err = await self._process.communicate()
        finally:
            self.seconds = time.monotonic() - self.began
        self.result = answer_of(out, err, self._process.returncode)
        if self.state != "cancelled":
            self.state = "failed" if "error" in self.result else "done"

    async def cancel(self) -> None:
        """End the command; what it had not finished is not left behind."""
        if self._process is not None and self._process.returncode is None:
            self.state = "cancelled"
            await end(self._process)

    def hear(self, report: dict[str, Any]) -> None:
        """Take in a line of progress: {"what", "share"} and, of some commands, {"left"}."""
        what = str(report["what"])
        if what != self.step:
            self.step = what
            self.steps.append(what)
        self.share = None if report["share"] is None else min(max(float(report["share"]), 0.0), 1.0)
        if "left" in report:
            self.left, self.heard = float(report["left"]), time.monotonic()
