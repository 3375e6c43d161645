"""What `--help` shows: the list of commands, and a command's options."""

import shutil
import textwrap
from collections.abc import Iterable, Sequence
from importlib.util import find_spec

from realsim.cli.command import GROUPS, Command
from realsim.cli.options import Option, options_of
from realsim.cli.table import commands
from realsim.core.errors import EXTRA_OF

WIDEST = 110
"""Columns of a help: an option is hard to find in longer lines."""
LEFT = 24
"""Columns of the names; a longer one has its description on the next line."""
EVERYWHERE = "everywhere: --json for machines, --quiet without progress"


def usage() -> str:
    """The list of commands in groups, with the optional parts that they need."""
    known = commands()
    width = max(map(len, known))
    titles = dict.fromkeys([*GROUPS, *(command.group for command in known.values())])
    lines = ["usage: realsim COMMAND [options]     realsim help COMMAND: all options of a command", ""]
    for title in titles:
        rows = {name: command for name, command in known.items() if command.group == title}
        if rows:
            lines += [title, *(_row(name, command, width) for name, command in rows.items()), ""]
    missing = sorted({c.extra for c in known.values() if c.extra and not is_installed(c.extra)})
    parts = 'each [part] is installed with pip install "realsim[part]"'
    lines.append(f"{parts}; not here: {', '.join(missing) or 'none, all are installed'}")
    return "\n".join([*lines, f"{EVERYWHERE}; --version; --completion bash|zsh|fish"])


def _row(name: str, command: Command, width: int) -> str:
    extra = f"  [{command.extra}]" if command.extra else ""
    return f"  {name:<{width}}  {command.summary}{extra}"


def is_installed(extra: str) -> bool:
    """Whether all packages of an optional part are here."""
    return all(find_spec(module) is not None for module, owner in EXTRA_OF.items() if owner == extra)


def help_of(name: str, command: Command, everything: bool) -> str:
    """A command's arguments and options: those that people use most, if it has very many, or all."""
    description, options = options_of(command.load())
    width = min(shutil.get_terminal_size().columns, WIDEST)
    arguments = [option for option in options if not option.names]
    named = [option for option in options if option.names]
    needed = [*arguments, *(option for option in named if option.required)]
    lines = [f"usage: realsim {name} {''.join(f'{_left(a)} ' for a in needed)}[options]", ""]
    for paragraph in description.split("\n\n"):
        lines += [*textwrap.wrap(" ".join(paragraph.split()), width), ""]
    lines += _rows(arguments, width)
    if command.common and not everything:
        chosen = [next(o for o in named if wanted in o.names) for wanted in command.common]
        lines += ["", "common options", *_rows(chosen, width), ""]
        lines.append(f"{len(named)} options in all: realsim help {name}")
    else:
        for group in dict.fromkeys(option.group for option in named):
            lines += [
                "",
                f"{group} options".strip().replace("_", " "),
                *_rows([o for o in named if o.group == group], width),
            ]
    lines += ["", f"example: {command.example}"]
    if any(option.parameter.startswith("config.") for option in options):
        lines.append(FILES)
    return "\n".join([*lines, EVERYWHERE])


FILES = (
    "options from a file: --config report.json (of an earlier scene); --preset phone|stairs|room|parkour for scenes; "
    "what is typed wins"
)


def _rows(options: Iterable[Option], width: int) -> list[str]:
    return [line for option in options for line in _described(_left(option), option.help, width)]


def _left(option: Option) -> str:
    return option.value if not option.names else f"{', '.join(option.names)} {option.value}".rstrip()


def _described(left: str, text: str, width: int) -> Sequence[str]:
    """A name and its description beside it, or below where the name is long."""
    below = textwrap.wrap(" ".join(text.split()), width - LEFT - 2) or [""]
    head = [f"  {left:<{LEFT - 2}}  {below.pop(0)}".rstrip()] if len(left) <= LEFT - 2 else [f"  {left}"]
    return [*head, *(" " * (LEFT + 2) + line for line in below)]
