"""One file a command; `realsim.cli.command_line` finds them by name."""

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from realsim.core.errors import printable

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


def set_arguments(arguments: Sequence[str]) -> None:
    """Remember the command's arguments as they were given, for commands that start themselves again for every item."""
    _arguments.set(tuple(arguments))


def other_arguments(drop: Mapping[str, int], positional: Sequence[str]) -> tuple[str, ...]:
    """The given arguments less the options in `drop` (name -> how many values it takes) and the positional paths."""
    rest: list[str] = []
    skip = 0
    for argument in _arguments.get():
        name, equals, _ = argument.partition("=")
        name = name.replace("_", "-")  # both are taken
        if skip:
            skip -= 1
        elif name in drop:
            skip = 0 if equals else drop[name]
        elif str(Path(argument)) not in positional:  # a name as the shell completes it ends in a slash
            rest.append(argument)
    return tuple(rest)


@dataclass(frozen=True)
class CommandResult:
    """Result of a command: text for a person, data for a machine, and an exit code."""

    text: str
    data: Mapping[str, Any] = field(default_factory=dict)
    exit_code: int = 0
    level: str = ""
    """good, look or bad, of commands that give a verdict: the colour of the first line."""

    def rendered(self, color: bool) -> str:
        """The text for a terminal: names from files cannot control it, and a verdict comes first, in its colour."""
        first, end, rest = printable(self.text).partition("\n")
        code = {"good": "32", "look": "33", "bad": "31"}.get(self.level, "")
        return (f"\x1b[1;{code}m{first}\x1b[0m" if color and code else first) + end + rest


DO_NOT_USE = 3
"""Exit code of a result that is not to be used, with `--strict`."""
WORDS = {"good": "Good", "look": "Check first", "bad": "Do not use"}


def verdict_lines(verdict: Mapping[str, Any]) -> list[str]:
    """A verdict (`level`, `headline`, `reasons`, `next`) as the first lines of a command's output."""
    return [
        f"{WORDS[verdict['level']]}: {verdict['headline']}",
        *(f"  because  {reason}" for reason in verdict["reasons"] if reason != verdict["headline"]),
        *(f"  next     {step}" for step in verdict["next"]),
    ]


def describe_sides(sides: Mapping[str, Any]) -> str:
    """How collision geometry stops rays from the side, in words."""
    if sides["stopped"] is None:
        return "too few side faces to measure"
    return f"{sides['stopped']:.1%} of rays from the side stop within 3 cm, {sides['through']:.1%} go through"


def strict_exit(verdict: Mapping[str, Any], strict: bool) -> int:
    """The exit code of a verdict."""
    return DO_NOT_USE if strict and verdict["level"] == "bad" else 0
