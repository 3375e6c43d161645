"""The tools of `realsim mcp`: what agents may ask for, each a `realsim` command in a process of its own.

A crash of a command is an error of one call; a call that is cancelled ends its command. Progress of long commands goes
on to the client. Paths lie in the folders that were named at the start.
"""

# Not with `from __future__ import annotations`: the library reads the types of the tools, which `build` imports.
import asyncio
import contextlib
import inspect
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from realsim import __version__, results
from realsim.cli.command import Command, Tool
from realsim.cli.help import is_installed
from realsim.cli.options import options_of
from realsim.cli.roots import LONGEST, Roots
from realsim.cli.started import answer_of, started
from realsim.cli.table import COMMANDS, commands
from realsim.core.errors import RealsimError
from realsim.core.files import read_json, to_json

INSTRUCTIONS = """\
realsim turns depth captures, scans and meshes into MuJoCo scenes (inspect, reconstruct, contact, export), and says
where and why a robot's logs differ from its simulator (diagnose). Read `verdict` of every result first: a scene with
the level "bad" and a diagnosis that is "unexplained" must not be used. Relative paths start at the first folder that
the server was started with; paths outside its folders are refused. An output folder must not exist yet, unless
overwrite is true."""
EVERY = 0.2
"""Seconds between two notifications about progress."""
LIMIT = 3600.0
"""Seconds that a call may take: a budget; on two cores the longest diagnosis that was timed took 25 minutes."""


def build(roots: Roots, jobs: int = 1, limit: float = LIMIT) -> Any:
    """The server (`mcp.server.mcpserver.MCPServer`), not yet running.

    Args:
        roots: folders that may be used.
        jobs: commands that run at a time; further calls wait.
        limit: seconds after which a command is ended.
    """
    from mcp.server.mcpserver import Context, MCPServer
    from mcp_types import ToolAnnotations

    server = MCPServer("realsim", version=__version__, instructions=INSTRUCTIONS, log_level="WARNING")
    free = asyncio.Semaphore(jobs)
    looks = ToolAnnotations(read_only_hint=True, open_world_hint=False)
    writes = ToolAnnotations(read_only_hint=False, destructive_hint=False, open_world_hint=False)

    def add(name: str, command: Command, tool: Tool) -> None:
        async def call(ctx: Context, **given: Any) -> dict[str, Any]:
            with _explained():  # a large folder takes its time, in which other calls are answered
                arguments, target = await asyncio.to_thread(_arguments, tool, given, roots)
            async with free:
                found = await _run([name, *arguments], ctx, roots.folders[0], limit)
            picked = _picked(found, tool.answers)
            return picked if target is None else picked | {"folder": str(target)}

        # The library reads name, description and parameters from the function.
        parameters = _parameters(command, tool)
        context = inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=Context)
        call.__name__, call.__doc__ = name, tool.description
        call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [*parameters, context], return_annotation=dict[str, Any]
        )
        call.__annotations__ = {p.name: p.annotation for p in [*parameters, context]} | {"return": dict[str, Any]}
        server.tool(annotations=writes if tool.writes else looks)(call)

    for name, command in commands().items():
        if command.tool is not None and (not command.extra or is_installed(command.extra)):
            add(name, command, command.tool)

    @server.tool(annotations=looks)
    async def report(folder: str) -> dict[str, Any]:
        """What is known of a finished scene or diagnosis: verdict, reasons, figures, and where its page is."""
        with _explained():
            return await asyncio.to_thread(lambda: _report(roots.source(folder)))

    return server


def _parameters(command: Command, tool: Tool) -> list[inspect.Parameter]:
    """What a tool takes: parameters of the command's function, or fields of its configuration, as they are there."""
    from pydantic import Field

    function = command.load()
    helps = {option.parameter.rpartition(".")[2]: option.help for option in options_of(function)[1]}
    kinds = _kinds(inspect.signature(function).parameters.values(), get_type_hints(function))
    found = []
    for name in filter(None, (tool.reads, tool.writes, *tool.options)):
        kind, default = kinds[name]
        if name == tool.reads:
            kind, default = str, inspect.Parameter.empty
        elif name == tool.writes:
            kind, default = str | None, None
        typed = Annotated[kind, Field(description=helps[name])]  # type: ignore[valid-type]
        found.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=typed))
    return found


def _kinds(parameters: Iterable[Any], hints: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Name -> type and default, of a function's parameters or a class's fields, and of what configurations hold."""
    found: dict[str, tuple[Any, Any]] = {}
    for parameter in parameters:
        kind = hints[parameter.name]
        if is_dataclass(kind):
            found |= _kinds(fields(kind), get_type_hints(kind))
        else:
            found[parameter.name] = (kind, parameter.default)
    return found


def _arguments(tool: Tool, given: Mapping[str, Any], roots: Roots) -> tuple[list[str], Path | None]:
    """What is typed for a call, and the folder that it writes. With "=", a value is never taken for an option."""
    values = {name: value for name, value in given.items() if value is not None}
    source = roots.source(values.pop(tool.reads))
    target = roots.path(values.pop(tool.writes)) if tool.writes in values else None
    arguments = [str(source)] if target is None else [str(source), f"--{tool.writes}={target}"]
    for name, value in values.items():
        flag = name.replace("_", "-")
        if isinstance(value, str) and ("\0" in value or len(value) > LONGEST):
            raise RealsimError(
                f"{name} cannot be passed on",
                expected=f"text of at most {LONGEST} characters without a zero byte",
                found=ascii(value[:80]),
                hint="give a value of a usual length",
            )
        if isinstance(value, bool):
            arguments += [f"--{flag}"] if value else []
        else:
            arguments.append(f"--{flag}={value}")
    return arguments, target


def _picked(data: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Some keys of a result, `health.warnings` as `warnings`; all of it if none are named."""
    if not keys:
        return data
    found = {}
    for key in keys:
        value: Any = data
        *parents, name = key.split(".")
        for parent in parents:
            value = value.get(parent, {})
        if name in value:
            found[name] = value[name]
    return found


def _report(folder: Path) -> dict[str, Any]:
    page = folder / "report.html"
    if (folder / "diagnosis.json").is_file():
        whole = read_json(folder / "diagnosis.json")
        results.Diagnosis.of(whole, folder)  # what is no diagnosis is refused
        tool = COMMANDS["diagnose"].tool
        kind, data = "diagnosis", _picked(whole, tool.answers if tool else ())
    else:
        scene = results.Scene.read(folder)
        kind, data = "scene", {k: v for k, v in asdict(scene).items() if k not in ("details", "report")}
    plain: dict[str, Any] = json.loads(to_json(data))
    return {"kind": kind, "folder": str(folder), "page": str(page) if page.is_file() else None} | plain


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """What a person or an agent can mend is an answer, not a crash."""
    from mcp.server.mcpserver.exceptions import ToolError

    try:
        yield
    except RealsimError as error:
        raise ToolError(error.render()) from error


async def _run(arguments: Sequence[str], ctx: Any, place: Path, limit: float) -> dict[str, Any]:
    """What a command prints with --json; its progress goes on to the client."""
    from mcp.server.mcpserver.exceptions import ToolError

    try:
        async with asyncio.timeout(limit), started(arguments, _Forward(ctx), place) as process:
            out, err = await process.communicate()
    except TimeoutError:
        raise ToolError(
            f"the command was ended after {limit / 60:g} minutes\n"
            "do: give fewer frames or runs, or start the server with a larger --minutes"
        ) from None
    data = answer_of(out, err, process.returncode)
    if "error" in data:
        facts = [f"{k}: {data[k]}" for k in ("file", "expected", "found", "hint") if data.get(k)]
        raise ToolError("\n".join([str(data["message"]), *facts]))
    return data


class _Forward:
    """Progress of a command as notifications: steps that were begun, the share of the last one, and its name."""

    def __init__(self, ctx: Any) -> None:
        self.ctx, self.count, self.last = ctx, Steps(), -EVERY

    async def __call__(self, line: dict[str, Any]) -> None:
        value, message = self.count(str(line["what"]), line["share"])
        if time.monotonic() - self.last > EVERY or line["share"] is None:
            self.last = time.monotonic()
            await self.ctx.report_progress(value, None, message)


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
