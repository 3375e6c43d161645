"""The tools of `realsim mcp`: what agents may ask for, each a `realsim` command in a process of its own.

A crash of a command is an error of one call; a call that is cancelled ends its command. Progress of long commands goes
on to the client. Paths lie in the folders that were named at the start.
"""

# Not with `from __future__ import annotations`: the library reads the types of the tools, which `build` imports.
import asyncio
import contextlib
import json
import os
import sys
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from realsim import __version__, results
from realsim.cli.child import PARENT, PROGRESS
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError, printable
from realsim.core.files import read_json, to_json

INSTRUCTIONS = """\
realsim turns depth captures, scans and meshes into MuJoCo scenes (inspect, reconstruct, contact, export), and says
where and why a robot's logs differ from its simulator (diagnose). Read `verdict` of every result first: a scene with
the level "bad" and a diagnosis that is "unexplained" must not be used. Relative paths start at the first folder that
the server was started with; paths outside its folders are refused. An output folder must not exist yet, unless
overwrite is true."""
SAID_OF_DIAGNOSES = (
    "schema", "verdict", "sentence", "causes", "equivalent", "where", "shrinkage", "unexplained_share",
    "next_experiment", "seconds",
)  # fmt: skip
"""Keys of a diagnosis that are answered; diagnosis.json has all."""
EVERY = 0.2
"""Seconds between two notifications about progress."""
GRACE = 20.0
"""Seconds that a cancelled command gets to clean up."""


def build(roots: Roots, jobs: int = 1) -> Any:
    """The server (`mcp.server.mcpserver.MCPServer`), not yet running.

    Args:
        roots: folders that may be used.
        jobs: commands that run at a time; further calls wait.
    """
    from mcp.server.mcpserver import Context, MCPServer
    from mcp_types import ToolAnnotations

    server = MCPServer("realsim", version=__version__, instructions=INSTRUCTIONS, log_level="WARNING")
    free = asyncio.Semaphore(jobs)
    looks = ToolAnnotations(read_only_hint=True, open_world_hint=False)
    writes = ToolAnnotations(read_only_hint=False, destructive_hint=False, open_world_hint=False)

    async def run(ctx: Context, command: str, *arguments: object) -> dict[str, Any]:
        async with free:
            return await _run([command, *map(str, arguments)], ctx)

    @server.tool(annotations=looks)
    async def inspect(capture: str, ctx: Context) -> dict[str, Any]:
        """Say what a capture folder or scan is taken for, every convention assumed, and what is wrong with it."""
        with _explained():
            source = roots.source(capture)
        return await run(ctx, "inspect", source)

    @server.tool(annotations=writes)
    async def reconstruct(
        capture: str,
        out: str,
        ctx: Context,
        robot: Literal["g1", "quadruped"] | None = None,
        max_frames: int = 300,
        seed: int = 0,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Turn a capture or scan into a metric, level MuJoCo scene; minutes. Read the verdict first.

        Args:
            capture: a folder of RGB-D frames, or a scan file.
            out: folder of the scene.
            robot: put on the start platform.
            max_frames: at most this many frames are used; 0 for all.
            seed: of everything random.
            overwrite: replace a scene that realsim wrote there.
        """
        with _explained():
            source, target = roots.source(capture), roots.path(out)
        options = [*_option("--robot", robot), "--max-frames", max_frames, "--seed", seed, *_flag(overwrite)]
        return await run(ctx, "reconstruct", source, "--out", target, *options)

    @server.tool(annotations=writes)
    async def contact(
        mesh: str,
        out: str,
        ctx: Context,
        unit: Literal["m", "cm", "mm", "inch"] | None = None,
        up: Literal["auto", "z", "y"] = "auto",
        ground_z: float | None = None,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Give a mesh file collision geometry for MuJoCo, chosen by measured error; a minute. Read the verdict first.

        Args:
            mesh: .ply, .obj, .stl, .glb or .off.
            out: folder of the scene.
            unit: of the file; metres if not given.
            up: axis of the file that points up.
            ground_z: height of the ground in metres; found if not given.
            overwrite: replace a scene that realsim wrote there.
        """
        with _explained():
            source, target = roots.source(mesh), roots.path(out)
        options = [*_option("--unit", unit), "--up", up, *_option("--ground-z", ground_z), *_flag(overwrite)]
        return await run(ctx, "contact", source, "--out", target, *options)

    @server.tool(annotations=writes)
    async def export(
        scene: str, to: list[str], ctx: Context, out: str | None = None, overwrite: bool = False
    ) -> dict[str, Any]:
        """Write a scene in the formats of other tools.

        Args:
            scene: folder that reconstruct or contact wrote.
            to: some of mjcf, warp, usd, urdf, sdf, terrain, glb, obj, stl, ply, heightmap; or all.
            out: gets a folder for each format; `export` in the scene's folder if not given.
            overwrite: replace formats that are there.
        """
        with _explained():
            source = roots.source(scene)
            target = roots.path(str(source / "export") if out is None else out)
        return await run(ctx, "export", source, f"--to={','.join(to)}", "--out", target, *_flag(overwrite))

    @server.tool(annotations=writes)
    async def diagnose(
        case: str,
        ctx: Context,
        out: str | None = None,
        check_only: bool = False,
        max_causes: int = 3,
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Say where a robot's logs differ from its simulator and what causes it; minutes, up to ten for a humanoid.

        Args:
            case: folder with log.json, model.xml and runs/.
            out: folder of the diagnosis; needed unless check_only.
            check_only: only say, within seconds, whether the log can be used and what is odd about it.
            max_causes: at most this many causes are named.
            overwrite: replace a diagnosis that realsim wrote there.
        """
        with _explained():
            source = roots.source(case)
            if out is None and not check_only:
                raise RealsimError("no folder for the diagnosis given", expected="out, or check_only")
            target = None if out is None else roots.path(out)
        if check_only or target is None:
            return await run(ctx, "diagnose", source, "--check")
        found = await run(ctx, "diagnose", source, "--out", target, "--max-causes", max_causes, *_flag(overwrite))
        warnings = found["health"]["warnings"]
        return {k: found[k] for k in SAID_OF_DIAGNOSES if k in found} | {"warnings": warnings, "folder": str(target)}

    @server.tool(annotations=looks)
    async def report(folder: str) -> dict[str, Any]:
        """What is known of a finished scene or diagnosis: verdict, reasons, figures, and where its page is."""
        with _explained():
            source = roots.source(folder)
            return await asyncio.to_thread(_report, source)

    return server


def _report(folder: Path) -> dict[str, Any]:
    page = folder / "report.html"
    if (folder / "diagnosis.json").is_file():
        whole = read_json(folder / "diagnosis.json")
        found = results.Diagnosis.of(whole, folder)
        kind, data = "diagnosis", {k: whole[k] for k in SAID_OF_DIAGNOSES if k in whole}
        data["warnings"] = list(found.warnings)
    else:
        scene = results.Scene.read(folder)
        kind, data = "scene", {k: v for k, v in asdict(scene).items() if k not in ("details", "report")}
    plain: dict[str, Any] = json.loads(to_json(data))
    return {"kind": kind, "folder": str(folder), "page": str(page) if page.is_file() else None} | plain


def _option(name: str, value: object) -> list[str]:
    # With "=", a value can never be taken for another option.
    return [] if value is None else [f"{name}={value}"]


def _flag(overwrite: bool) -> list[str]:
    return ["--overwrite"] if overwrite else []


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """What a person or an agent can mend is an answer, not a crash."""
    from mcp.server.mcpserver.exceptions import ToolError

    try:
        yield
    except RealsimError as error:
        raise ToolError(error.render()) from error


async def _run(arguments: Sequence[str], ctx: Any) -> dict[str, Any]:
    """What a command prints with --json; its progress goes on to the client."""
    from mcp.server.mcpserver.exceptions import ToolError

    async with _command([*arguments, "--json"]) as (process, pipe), asyncio.TaskGroup() as tasks:
        listening = tasks.create_task(_forward(pipe, ctx))
        out, err = await process.communicate()
        listening.cancel()
    try:
        data = json.loads(out)
    except ValueError:
        end = printable(err[-2000:].decode(errors="replace"))
        raise ToolError(f"the command ended without a result (exit code {process.returncode})\n{end}") from None
    if "error" in data:
        facts = [f"{k}: {data[k]}" for k in ("file", "expected", "found", "hint") if data.get(k)]
        raise ToolError("\n".join([str(data["message"]), *facts]))
    return dict(data)


@asynccontextmanager
async def _command(arguments: Sequence[str]) -> AsyncIterator[tuple[asyncio.subprocess.Process, asyncio.StreamReader]]:
    """A running command and the pipe with its progress; however it is left, the command has ended then."""
    reading, writing = os.pipe()
    environment = dict(os.environ) | {PARENT: str(os.getpid()), PROGRESS: str(writing)}
    try:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "realsim.cli.child", *arguments,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
            pass_fds=(writing,), env=environment,
        )  # fmt: skip
    finally:
        os.close(writing)
    pipe = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(pipe), os.fdopen(reading, "rb"))
    try:
        yield process, pipe
    finally:
        transport.close()
        if process.returncode is None:
            process.terminate()
            try:
                await asyncio.wait_for(process.wait(), GRACE)
            except TimeoutError:
                process.kill()
                await process.wait()


async def _forward(pipe: asyncio.StreamReader, ctx: Any) -> None:
    """Progress of a command as notifications: steps that were begun, the share of the last one, and its name."""
    count = Steps()
    last = -EVERY
    while line := await pipe.readline():
        try:
            said = json.loads(line)
            value, message = count(str(said["what"]), said["share"])
        except (ValueError, KeyError, TypeError):
            continue
        if time.monotonic() - last > EVERY or said["share"] is None:
            last = time.monotonic()
            await ctx.report_progress(value, None, message)


class Steps:
    """One number that only grows, of steps whose number nobody knows beforehand."""

    def __init__(self) -> None:
        self.begun = 0
        self.what = ""
        self.value = 0.0

    def __call__(self, what: str, share: float | None) -> tuple[float, str]:
        """(progress, message): steps before this one, and the share of it."""
        if what != self.what:
            self.what, self.begun = what, self.begun + 1
        wanted = self.begun - 1 + min(max(share or 0.0, 0.0), 1.0)
        self.value = wanted if wanted > self.value else self.value + 1e-6
        return self.value, what if share is None else f"{what}: {share:.0%}"
