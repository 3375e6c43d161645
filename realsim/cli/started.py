"""Commands in processes of their own, as the page, the tools for agents and jobs start them: a crash of one is an
error of one, and whoever starts a command ends it."""

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from realsim.cli.child import PARENT, PROGRESS
from realsim.core.errors import printable

GRACE = 20.0
"""Seconds that a command gets to stop and clean up before it is killed."""
MOST_OUTPUT = 64 * 2**20
"""Bytes that a command may print as its result."""
TAIL = 2000
"""Bytes at the end of what it printed beside it that a crash is reported with."""
Heard = Callable[[dict[str, Any]], Awaitable[None] | None]
"""Called with a line of progress: {"what", "share"} and, of some commands, {"left"}."""


def command_line(arguments: Sequence[str]) -> list[str]:
    """What is run. -P: a module that lies in the folder of the data must not be imported."""
    return [sys.executable, "-P", "-m", "realsim.cli.child", *arguments, "--json"]


@asynccontextmanager
async def started(
    arguments: Sequence[str], heard: Heard, place: Path | None = None
) -> AsyncIterator[asyncio.subprocess.Process]:
    """A running command in the folder `place`, its progress handed on; however this is left, it has ended then."""
    reading, writing = os.pipe()
    environment = dict(os.environ) | {PARENT: str(os.getpid()), PROGRESS: str(writing)}
    try:
        process = await asyncio.create_subprocess_exec(
            *command_line(arguments), stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE, pass_fds=(writing,), env=environment, cwd=place,
        )  # fmt: skip
    finally:
        os.close(writing)
    pipe = asyncio.StreamReader()
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(pipe), os.fdopen(reading, "rb")
    )
    listening = asyncio.create_task(_listen(pipe, heard))
    try:
        yield process
    finally:
        listening.cancel()
        transport.close()
        await end(process)


async def _listen(pipe: asyncio.StreamReader, heard: Heard) -> None:
    while line := await pipe.readline():
        with suppress(ValueError, KeyError, TypeError):
            answer = heard(json.loads(line))
            if answer is not None:
                await answer


async def end(process: asyncio.subprocess.Process) -> None:
    """End a command that still runs; what it had not finished is not left behind."""
    if process.returncode is not None:
        return
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), GRACE)
    except TimeoutError:
        process.kill()
        await process.wait()


def answer_of(out: bytes, beside: bytes, code: int | None) -> dict[str, Any]:
    """What a command printed with --json, an error's fields included; or that it printed nothing of the kind.

    Args:
        beside: the end of what it printed on standard error.
        code: its exit code.
    """
    with suppress(ValueError):
        found = json.loads(out) if len(out) <= MOST_OUTPUT else None
        if isinstance(found, dict):
            return found
    what = "ended without a result" if code is None or code >= 0 else f"was killed by signal {-code}"
    end = printable(beside[-TAIL:].decode(errors="replace")).strip()
    return {"error": "Crash", "message": f"the command {what} (exit code {code})", "found": end}
