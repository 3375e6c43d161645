"""What a command is: one declaration, from which command line, help, completion and tools for agents are made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from realsim.core.errors import explain_missing_packages
from realsim.core.registry import installed, load_entry

GROUPS = ("Scenes", "Robots and their logs", "Policies", "Machines", "To try")
"""Titles of the help, in its order; commands of packages may add further ones."""


@dataclass(frozen=True)
class Tool:
    """How agents may use a command (`realsim mcp`): as a tool with these of its parameters, and no others.

    Types, defaults and descriptions are those of the command's own parameters.
    """

    description: str
    reads: str
    """The parameter that is the file or folder to read."""
    writes: str = ""
    """The parameter that is the folder to write."""
    options: tuple[str, ...] = ()
    """Further parameters: plain values."""
    answers: tuple[str, ...] = ()
    """Keys of the result that are answered (`health.warnings` of one inside another); all if none are named."""


@dataclass(frozen=True)
class Command:
    """A command of `realsim`."""

    function: str
    """`package.module:function`: its parameters (frozen dataclasses among them) are the options, its docstring the
    help, and it returns a `CommandResult`. Empty for a command of an entry point, which names the function itself."""
    summary: str
    """Its line in `realsim --help`."""
    example: str
    """A call that works, the last line of its help."""
    group: str
    """The title below which it is listed; see GROUPS."""
    extra: str = ""
    """The optional part of the installation that it needs (`pip install "realsim[EXTRA]"`)."""
    common: tuple[str, ...] = ()
    """The options that `realsim COMMAND --help` shows; all if none are named. `realsim help COMMAND` shows all."""
    tool: Tool | None = None
    takes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Parameter -> kinds of input that it takes, where `realsim.core.recognise.TAKES` does not say it."""

    @property
    def package(self) -> str:
        """The top package that it is from; its `schemas/COMMAND.json` says what it prints with --json."""
        return self.function.partition(":")[0].partition(".")[0]

    def load(self) -> Callable[..., Any]:
        """The function, imported now.

        Raises:
            RealsimError: the package that adds it is broken, or lacks a part of the installation.
        """
        if self.package == "realsim":
            return load_entry(self.function)
        what = f"the command {self.function}"
        with installed("command", self.function, self.function, "realsim.commands"), explain_missing_packages(what):
            return load_entry(self.function)
