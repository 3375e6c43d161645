"""One file a command; `realsim.cli` finds them by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
        if skip:
            skip -= 1
        elif name in drop:
            skip = 0 if equals else drop[name]
        elif str(Path(argument)) not in positional:  # a name as the shell completes it ends in a slash
            rest.append(argument)
    return tuple(rest)


@dataclass(frozen=True)
class CommandResult:
    """What a command has to say: to a person, to a machine, and to the shell."""

    text: str
    data: Mapping[str, Any] = field(default_factory=dict)
    exit_code: int = 0
