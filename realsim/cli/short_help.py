"""The help of a command that has more options than a screen holds: those that people use most, and where the rest is.

It is cut out of the full help, so an option is described once. The full help is boxes of 80 columns or more; an option
begins at the left edge of a box and goes on below, farther right.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_BEGIN, _END, _EDGE = "╭", "╰", "│"
_TITLE = "─ common options "


def short(text: str, names: Sequence[str], command: str) -> str:
    """`text`, the full help, with one box of the options `names` (`--out`, ...) instead of all boxes of options.

    Raises:
        KeyError: the command has no such option.
    """
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(_BEGIN) and "options" in line)
    last = max(i for i, line in enumerate(lines) if line.startswith(_END))
    options = _options(lines[first : last + 1])
    chosen = [line for name in ("--help", *names) for line in options[name]]
    width = len(lines[first])
    box = [_BEGIN + _TITLE.ljust(width - 2, "─") + "╮", *chosen, lines[last]]
    rest = f"{len(options)} options in all: realsim help {command}"
    return "\n".join([*lines[:first], *box, *lines[last + 1 :], rest])


def _options(lines: Sequence[str]) -> dict[str, list[str]]:
    """Option -> its lines in the boxes."""
    found: dict[str, list[str]] = {}
    lines_of: list[str] = []
    for line in lines:
        name = re.match(rf"{_EDGE} (?:-\w, )?(--[a-z][a-z-]*)", line)
        if name:
            lines_of = found.setdefault(name[1], [])
        elif line.startswith((_BEGIN, _END)):
            lines_of = []  # of a box's description
        if line.startswith(_EDGE) and line.strip(f"{_EDGE} "):
            lines_of.append(line)
    return found
