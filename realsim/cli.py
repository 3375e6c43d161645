"""The command line: `realsim COMMAND ...`. Every command is a function elsewhere; this file only finds and calls it.

A command is a function whose parameters (frozen dataclasses among them) become its options, and which returns a
`CommandResult`: lines for a person, a dictionary for a machine (`--json`), an exit code.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from realsim import __version__
from realsim.commands import set_arguments
from realsim.errors import RealsimError
from realsim.files import to_json
from realsim.progress import console, set_quiet
from realsim.registry import Registry

COMMANDS = Registry(
    "command",
    {
        "reconstruct": "realsim.commands.reconstruct:reconstruct",
        "inspect": "realsim.commands.inspect:inspect",
        "record": "realsim.commands.record:record",
        "view": "realsim.commands.view:view",
        "contact": "realsim.commands.contact:contact",
        "export": "realsim.commands.export:export",
        "model": "realsim.commands.model:model",
        "log": "realsim.commands.log:log",
        "diagnose": "realsim.commands.diagnose:diagnose",
        "synth": "realsim.commands.synth:synth",
        "demo": "realsim.commands.demo:demo",
    },
)
SUMMARIES = {
    "reconstruct": "frames or a scan -> a metric, level MuJoCo scene with a report",
    "inspect": "what a capture is taken for, and what is wrong with it",
    "record": "frames of a RealSense camera into a folder",
    "view": "look at a scene in the browser, live",
    "contact": "collision geometry for any mesh, chosen by measured error and cost",
    "export": "a scene in other formats: USD, URDF, SDF, GLB, height map, ...",
    "model": "how a feed-forward model in an ONNX file fits the contract",
    "log": "what a robot's recording holds (MCAP, bags, LeRobot, CSV, ...), and the case that it becomes",
    "diagnose": "a robot's logs and its model -> where the sim-to-real gap lies, what causes it, how much",
    "synth": "render a synthetic capture with its truth",
    "demo": "render, reconstruct and measure, end to end",
}


def commands() -> tuple[Registry, dict[str, str]]:
    """All commands and their summaries: those above, and those that packages add (entry points `realsim.commands`).

    A package that adds commands says what they do in `SUMMARIES` of the package that their modules stand in, or of a
    module that stands alone.
    """
    added = {point.name: point.value for point in entry_points(group="realsim.commands")}
    modules = {name: value.partition(":")[0] for name, value in added.items()}
    places = {name: import_module(module.rpartition(".")[0] or module) for name, module in modules.items()}
    said = {name: text for place in places.values() for name, text in getattr(place, "SUMMARIES", {}).items()}
    # In the order in which a package says them; what it says nothing about comes last.
    more = {name: text for name, text in said.items() if name in added} | {n: "" for n in added if n not in said}
    return COMMANDS.joined(added), SUMMARIES | {name: text for name, text in more.items() if name not in SUMMARIES}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code is 0, 2 for bad input, 130 after an interrupt, or the command's own."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    as_json = _take(arguments, "--json")
    set_quiet(_take(arguments, "--quiet") or as_json or not sys.stderr.isatty())
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage())
        return 0 if arguments else 2
    if arguments[0] == "--version":
        print(__version__)
        return 0
    # Telemetry of a dependency stays off whatever the command.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGTERM, _interrupt)
    try:
        result = _run(arguments[0], arguments[1:])
    except RealsimError as error:
        return _fail(error, as_json)
    except SystemExit as stop:
        # tyro has said on stderr what does not fit (2), or has shown the help (0).
        if as_json and stop.code:
            print(to_json({"error": "UsageError", "message": "the arguments do not fit", "hint": "see stderr"}), end="")
        return int(stop.code or 0)
    except KeyboardInterrupt:
        if as_json:
            print(to_json({"error": "Interrupted", "message": "interrupted"}), end="")
        else:
            console.print(
                "interrupted: nothing half-written is left; finished stages are kept and reused", style="yellow"
            )
        return 130
    except BrokenPipeError:
        return _unread()
    try:
        print(to_json(result.data) if as_json else result.text, end="" if as_json else "\n", flush=True)
    except BrokenPipeError:
        _unread()
    return result.exit_code


def usage() -> str:
    """The list of commands."""
    summaries = commands()[1]
    width = max(map(len, summaries))
    lines = [f"  {name:<{width}}  {text}" for name, text in summaries.items()]
    head = "usage: realsim COMMAND [options]   (realsim COMMAND --help for its options)"
    foot = "everywhere: --json for machines, --quiet without progress, --version"
    return "\n".join([head, "", *lines, "", foot])


def _run(name: str, arguments: list[str]) -> Any:
    import tyro

    command = commands()[0][name]
    set_arguments(arguments)
    return tyro.cli(
        command,
        prog=f"realsim {name}",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes,),
    )


def _fail(error: RealsimError, as_json: bool) -> int:
    if as_json:
        print(to_json(error.as_dict()), end="")
    else:
        console.print(f"error: {error.render()}", style="red", highlight=False, markup=False, soft_wrap=True)
    return 2


def _unread() -> int:
    """Whoever read the output (head, a pager) has seen enough; the interpreter must not try to flush it again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _take(arguments: list[str], flag: str) -> bool:
    found = flag in arguments
    while flag in arguments:
        arguments.remove(flag)
    return found


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
