"""The command line: `realsim COMMAND ...`. Every command is a function elsewhere; this file only finds and calls it.

A command is a function whose parameters (frozen dataclasses among them) become its options, and which returns a
`CommandResult`: lines for a person, a dictionary for a machine (`--json`), an exit code.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import re
import shutil
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

from realsim import __version__
from realsim.cli import schemas
from realsim.cli.commands import set_arguments
from realsim.cli.short_help import short
from realsim.core.errors import RealsimError, explain_missing_packages
from realsim.core.files import to_json
from realsim.core.progress import console, set_quiet
from realsim.core.registry import Registry

COMMANDS = Registry(
    "command",
    {
        "reconstruct": "realsim.cli.commands.reconstruct:reconstruct",
        "inspect": "realsim.cli.commands.inspect:inspect",
        "record": "realsim.cli.commands.record:record",
        "view": "realsim.cli.commands.view:view",
        "contact": "realsim.cli.commands.contact:contact",
        "export": "realsim.cli.commands.export:export",
        "model": "realsim.cli.commands.model:model",
        "log": "realsim.cli.commands.log:log",
        "diagnose": "realsim.cli.commands.diagnose:diagnose",
        "footholds": "realsim.cli.commands.footholds:footholds",
        "worker": "realsim.cli.commands.worker:worker",
        "mcp": "realsim.cli.commands.mcp:mcp",
        "schema": "realsim.cli.commands.schema:schema",
        "excite": "realsim.cli.commands.excite:excite",
        "synth": "realsim.cli.commands.synth:synth",
        "demo": "realsim.cli.commands.demo:demo",
    },
)
SUMMARIES = {
    "reconstruct": "frames or a scan -> a metric, level MuJoCo scene with a report",
    "inspect": "how a capture is recognised, and what is wrong with it",
    "record": "frames of a RealSense camera into a folder",
    "view": "look at a scene in the browser, live",
    "contact": "collision geometry for any mesh, chosen by measured error and cost",
    "export": "a scene in other formats: USD, URDF, SDF, GLB, height map, ...",
    "model": "check a feed-forward model in an ONNX file",
    "log": "contents of a robot's recording (MCAP, bags, LeRobot, CSV, ...), and a case made from it",
    "diagnose": "a robot's logs and its model -> where the sim-to-real gap lies, what causes it, how much",
    "footholds": "a robot's log against the scene it walked on -> which foothold is otherwise, by how much",
    "worker": "does the jobs of a folder that several machines share",
    "mcp": "realsim as tools for agents (Model Context Protocol)",
    "schema": "what a command prints with --json, as a JSON Schema",
    "excite": "the recording that tells apart what a diagnosis could not: command files within the robot's limits",
    "synth": "render a synthetic capture with its truth",
    "demo": "render, reconstruct and measure, end to end",
}
EXAMPLES = {
    "reconstruct": "realsim reconstruct my_capture --out scene --robot g1",
    "inspect": "realsim inspect my_capture",
    "record": "realsim record my_capture --seconds 30",
    "view": "realsim view scene",
    "contact": "realsim contact stairs.stl --unit mm --out stairs",
    "export": "realsim export scene --to usd,urdf",
    "model": "realsim model inspect model.onnx",
    "log": "realsim log walk.mcap --model robot.xml --out case",
    "diagnose": "realsim diagnose my_case --out diagnosis",
    "footholds": "realsim footholds my_case --scene scene --out footholds",
    "worker": "realsim worker scenes --idle 60",
    "mcp": "realsim mcp --root ~/captures ~/scenes",
    "schema": "realsim schema reconstruct",
    "excite": "realsim excite diagnosis --out experiment",
    "synth": "realsim synth --terrain boxes --out synthetic",
    "demo": "realsim demo --out demo_out",
}

COMMON = {
    "reconstruct": (
        "--out", "--robot", "--overwrite", "--strict", "--layout", "--depth-unit", "--unit", "--every", "--poses",
        "--backend", "--keep", "--start", "--goal", "--contact",
    ),
    "contact": ("--out", "--unit", "--up", "--ground-z", "--robot", "--overwrite", "--strict", "--contact"),
    "diagnose": (
        "--out", "--model", "--policy", "--scene", "--since", "--check", "--init", "--effects", "--overwrite",
        "--strict",
    ),
}  # fmt: skip
"""Command -> the options that `realsim COMMAND --help` shows, if it does not show all."""


def commands() -> tuple[Registry, dict[str, str]]:
    """All commands and their summaries: those above, and those that packages add (entry points `realsim.commands`).

    A package that adds commands says what they do in `SUMMARIES` of the package that their modules stand in, or of a
    module that stands alone.
    """
    added = {point.name: point.value for point in entry_points(group="realsim.commands")}
    said = _said("SUMMARIES", {})
    # In the order in which a package says them; what it says nothing about comes last.
    more = {name: text for name, text in said.items() if name in added} | {n: "" for n in added if n not in said}
    return COMMANDS.joined(added), SUMMARIES | {name: text for name, text in more.items() if name not in SUMMARIES}


def home_of() -> dict[str, str]:
    """Command -> top package that it is from."""
    added = {
        point.name: point.value.partition(".")[0].partition(":")[0] for point in entry_points(group="realsim.commands")
    }
    return dict.fromkeys(COMMANDS, "realsim") | {name: home for name, home in added.items() if name not in COMMANDS}


def _places() -> list[ModuleType]:
    """The packages of commands that installed packages add, or the modules themselves where they stand alone."""
    modules = [point.value.partition(":")[0] for point in entry_points(group="realsim.commands")]
    return [import_module(module.rpartition(".")[0] or module) for module in modules]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code is 0, 2 for bad input, 3 for "do not use" with --strict, 130 after an interrupt,
    or the command's own."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    as_json = _take(arguments, "--json")
    set_quiet(_take(arguments, "--quiet") or as_json or not sys.stderr.isatty())
    everything = len(arguments) == 2 and arguments[0] == "help"
    if everything:
        arguments = [arguments[1], "--help"]
    if not arguments or arguments[0] in ("-h", "--help", "help"):
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
        result = _run(arguments[0], arguments[1:], everything)
    except RealsimError as error:
        return _fail(error, as_json)
    except SystemExit as stop:
        return int(stop.code or 0)  # the help was asked for
    except UsageError as error:
        print(error.shown, end="", file=sys.stderr)
        if as_json:
            hint = f"realsim help {arguments[0]}"
            print(_error({"error": "UsageError", "message": error.message, "hint": hint}), end="")
        return 2
    except KeyboardInterrupt:
        if as_json:
            print(_error({"error": "Interrupted", "message": "interrupted"}), end="")
        else:
            console.print(
                "interrupted: nothing half-written is left; finished stages are kept and reused", style="yellow"
            )
        return 130
    except BrokenPipeError:
        return _unread()
    try:
        text = (
            to_json(answer(arguments[0], result.data)) if as_json else result.rendered(color=sys.stdout.isatty()) + "\n"
        )
        print(text, end="", flush=True)
    except BrokenPipeError:
        _unread()
    return result.exit_code


def answer(command: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """What `--json` prints: the data of a command, and first which schema it has (`realsim schema COMMAND`)."""
    name = schemas.name_of(command, home_of().get(command, "realsim"))
    return dict(data) if name is None else {"schema": name, **data}


def _error(data: Mapping[str, Any]) -> str:
    return to_json({"schema": schemas.ERROR, **data})


def usage() -> str:
    """The list of commands."""
    summaries = commands()[1]
    width = max(map(len, summaries))
    lines = [f"  {name:<{width}}  {text}" for name, text in summaries.items()]
    head = "usage: realsim COMMAND [options]   (realsim help COMMAND for all its options)"
    foot = f"{EVERYWHERE}, --version"
    return "\n".join([head, "", *lines, "", foot])


def _run(name: str, arguments: list[str], everything: bool) -> Any:
    import tyro

    with explain_missing_packages(f"realsim {name}"):
        command = commands()[0][name]
        set_arguments(arguments)

        @functools.wraps(command)
        def later(*args: Any, **options: Any) -> Any:
            return functools.partial(command, *args, **options)

        common = () if everything else _said("COMMON", COMMON).get(name, ())
        with _plain_help(name, common) if {"-h", "--help"} & set(arguments) else _plain_errors():
            call = tyro.cli(later, prog=f"realsim {name}", args=arguments, config=(tyro.conf.OmitArgPrefixes,))
        return call()


@contextlib.contextmanager
def _plain_help(name: str, common: Sequence[str]) -> Iterator[None]:
    """What tyro prints, with the groups of options named for people, an example, and the options of all commands; of
    the command's own only `common`, if any are given."""
    shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    # Wider terminals get boxes side by side, in which an option is hard to find.
    width = str(min(shutil.get_terminal_size().columns, WIDEST))
    try:
        with contextlib.redirect_stdout(shown), _environment("COLUMNS", width):
            yield
    finally:
        shown.seek(0)
        text = UNSET.sub(_blank, NONE.sub(_without_none, GROUP.sub(_group, shown.read())))
        text = short(text.rstrip(), common, name) if common else text.rstrip()
        example = _said("EXAMPLES", EXAMPLES).get(name)
        if not (sys.stdout.encoding or "utf-8").lower().startswith("utf"):
            text = text.translate(str.maketrans("╭╮╰╯│─", "    |-"))
        lines = [text, "", *([f"example: {example}"] if example else []), EVERYWHERE]
        with contextlib.suppress(BrokenPipeError):
            print("\n".join(lines), flush=True)


@contextlib.contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


class UsageError(Exception):
    """Arguments that do not fit the command."""

    def __init__(self, shown: str) -> None:
        self.shown = shown
        """For a terminal."""
        box = shown[shown.find("╭") + 1 :].partition("For full helptext")[0].splitlines()[1:]  # less its title
        self.message = " ".join(line.strip("│ ") for line in box if line.strip("│─- "))


@contextlib.contextmanager
def _plain_errors() -> Iterator[None]:
    """What tyro prints about arguments that do not fit, as a UsageError that has the names of options."""
    shown = io.TextIOWrapper(io.BytesIO(), encoding=sys.stderr.encoding or "utf-8", errors="replace")
    try:
        with contextlib.redirect_stderr(shown):
            yield
    except SystemExit as stop:
        if not stop.code:
            raise
        shown.seek(0)
        raise UsageError(PARSED.sub(_option_names, shown.read())) from None


PARSED = re.compile(r"Error parsing (?:config|many)[.\w]*: ([^│\n]*)")
"""A value that a config refuses: the path of the config, and its words with the names of its fields."""


def _option_names(match: re.Match[str]) -> str:
    said = re.sub(r"\b[a-z]+(?:_[a-z]+)+\b", lambda name: "--" + name[0].replace("_", "-"), match[1].rstrip())
    return said + " " * (len(match[0]) - len(said))


GROUP = re.compile(r"(config|many)((?:\.\w+)*) options (.)\3*")
"""The title of a group of options: the path of a field, and the characters that fill the line after it."""
WIDEST = 110
"""Columns of a help."""
EVERYWHERE = "everywhere: --json for machines, --quiet without progress"


TITLES = {"config": "general options ", "many": "options for several inputs "}
NONE = re.compile(r"\{None\}\|(?:\{([^}\n]*)\}|(\S+))|\{None,(\S+)")
"""What an option takes that may be left out: the help shows what it takes."""
UNSET = re.compile(r"\(default:(\s*(?:│\n│)?\s*)(None|'')?\)")
"""A default that says nothing; it may stand on two lines of a box."""


def _group(match: re.Match[str]) -> str:
    """The title of the same length without the names that only the source code knows."""
    name = match[2].rpartition(".")[2]
    title = f"{name} options " if name else TITLES[match[1]]
    return title + match[3] * (len(match[0]) - len(title))


def _without_none(match: re.Match[str]) -> str:
    kept = match[1] or match[2] or "{" + match[3]
    return kept + " " * (len(match[0]) - len(kept))


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\s│]", " ", match[0])


def _said(what: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Command -> EXAMPLES or COMMON; packages that add commands have theirs beside SUMMARIES."""
    return dict(own) | {name: value for place in _places() for name, value in getattr(place, what, {}).items()}


def _fail(error: RealsimError, as_json: bool) -> int:
    if as_json:
        print(_error(error.as_dict()), end="")
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
