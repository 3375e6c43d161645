"""The command line: `realsim COMMAND ...`. Every command is a function elsewhere (`table`); this file calls it."""

import contextlib
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from realsim import __version__
from realsim.cli import schemas
from realsim.cli.commands import CommandResult, set_arguments
from realsim.cli.help import help_of, usage
from realsim.cli.options import UsageError, parse
from realsim.cli.saved import defaults_of
from realsim.cli.table import find
from realsim.core.engine import check_mujoco
from realsim.core.errors import RealsimError, explain_missing_packages, require
from realsim.core.files import to_json
from realsim.core.progress import broken_by_interrupt, console, forget_interrupt, interrupt, set_quiet
from realsim.core.recognise import TAKES, explain_inputs


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code is 0, 2 for bad input, 3 for "do not use" with --strict, 130 after an interrupt,
    or the command's own."""
    open_streams()
    arguments = list(sys.argv[1:] if argv is None else argv)
    as_json = _take(arguments, "--json")
    set_quiet(_take(arguments, "--quiet") or as_json or not sys.stderr.isatty())
    # Telemetry of a dependency stays off whatever the command.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    forget_interrupt()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, interrupt)
        if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
            signal.signal(signal.SIGINT, interrupt)
    try:
        with broken_by_interrupt():
            text, code = _answered(arguments, as_json)
        return code if _write(sys.stdout, text) else 2
    except RealsimError as error:
        if as_json:
            _write(sys.stdout, _error(error.as_dict()))
        else:
            named = arguments[0] if arguments and arguments[0].isalpha() else "COMMAND"
            _tell(f"error: {error.render()}".replace("realsim help COMMAND", f"realsim help {named}"), "red")
        return 2
    except KeyboardInterrupt as ended:
        if as_json:
            message = f"interrupted: {ended}" if str(ended) else "interrupted"
            _write(sys.stdout, _error({"error": "Interrupted", "message": message}))
        else:
            kept = "; finished stages are kept and reused" if _keeps_stages(arguments) else ""
            _tell(f"interrupted: {ended if str(ended) else f'nothing half-written is left{kept}'}", "yellow")
        return 130
    except BrokenPipeError:
        _drop(sys.stdout)
        return 0


def _keeps_stages(arguments: list[str]) -> bool:
    """Whether a command keeps finished stages: one with --no-cache, which was not given."""
    name = next(iter(arguments), "")
    return "--no-cache" not in sys.argv and name.isalpha() and "--no-cache" in help_of(name, find(name), True)


def _answered(arguments: list[str], as_json: bool) -> tuple[str, int]:
    """What is printed, and the exit code."""
    if as_json and not arguments:
        raise UsageError("no command is named", expected="realsim COMMAND", hint="realsim help")
    if not arguments or arguments in (["-h"], ["--help"], ["help"]):
        return usage() + "\n", 0 if arguments else 2
    if arguments[0] == "--version":
        return (to_json({"version": __version__}) if as_json else __version__) + "\n", 0
    if arguments[0] == "--completion":
        from realsim.cli.completion import script

        return script(arguments[1] if len(arguments) > 1 else ""), 0
    everything = arguments[0] == "help"
    name, *rest = arguments[everything:]
    if everything or {"-h", "--help"} & set(rest):
        with explain_missing_packages(f"realsim {name}"):
            return help_of(name, find(name), everything) + "\n", 0
    result = _run(name, rest)
    if as_json:
        return to_json(answer(name, result.data)), result.exit_code
    return result.rendered(color=sys.stdout.isatty()) + "\n", result.exit_code


def _run(name: str, arguments: list[str]) -> CommandResult:
    """Result of a command."""
    command = find(name)
    with explain_missing_packages(f"realsim {name}"):
        function = command.load()
        set_arguments(arguments)
        file, preset = _take_value(arguments, "--config"), _take_value(arguments, "--preset")
        defaults = None if file is None and preset is None else defaults_of(function, file, preset)
        call = parse(function, name, arguments, defaults)
        check_mujoco()
        if command.extra:
            require(command.extra, f"realsim {name}")
        result = explain_inputs(function, TAKES | dict(command.takes))(*call.args, **call.keywords)
    if not isinstance(result, CommandResult):
        raise RealsimError(
            f"the command {name!r} of an installed package gave no result",
            expected="a CommandResult of realsim.cli.commands",
            found=type(result).__name__,
        )
    return result


def answer(command: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """What `--json` prints: the data of a command, and first which schema it has (`realsim schema COMMAND`)."""
    name = schemas.name_of(command, find(command).package)
    return dict(data) if name is None else {"schema": name, **data}


def _error(data: Mapping[str, Any]) -> str:
    return to_json({"schema": schemas.ERROR, **data})


def open_streams() -> None:
    """Standard streams that were closed (`2>&-`) take what is written and forget it.

    Their numbers must not go to the next file that is opened: a library that prints would write into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 (until the end)
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a terminal that lacks a character is no reason to fail


def _write(stream: TextIO, text: str) -> bool:
    """Whether a text could be written, or its reader has seen enough (head, a pager)."""
    try:
        stream.write(text)
        stream.flush()
    except BrokenPipeError:
        _drop(stream)
    except OSError as error:  # a full disk
        _drop(stream)
        refused = RealsimError(
            "cannot write to standard output", found=error.strerror, hint="free some space, or write elsewhere"
        )
        _tell(f"error: {refused.render()}", "red")
        return False
    return True


def _tell(text: str, style: str) -> None:
    """A message to the person who watches, who may have closed the window."""
    try:
        console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
    except OSError:
        _drop(sys.stderr)


def _drop(stream: TextIO) -> None:
    """Forget what a stream still holds: the interpreter must not try to write it again at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _take(arguments: list[str], flag: str) -> bool:
    found = flag in arguments
    while flag in arguments:
        arguments.remove(flag)
    return found


def _take_value(arguments: list[str], flag: str) -> str | None:
    """The value of an option that comes before all others."""
    for i, word in enumerate(arguments):
        if word.startswith(f"{flag}="):
            return arguments.pop(i).partition("=")[2]
        if word == flag:
            taken = arguments[i + 1 : i + 2]
            if not taken or taken[0].startswith("--"):
                raise UsageError(f"{flag} lacks a value", expected=f"{flag} VALUE", hint="realsim help COMMAND")
            del arguments[i : i + 2]
            return taken[0]
    return None
