"""`realsim mcp`: realsim as tools for agents, over the Model Context Protocol."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError


def mcp(root: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = (), jobs: int = 1) -> CommandResult:
    """Serve inspect, reconstruct, contact, export, diagnose and report to an agent, over standard input and output.

    Nothing outside the folders is read or written, wherever links lead. See docs/agents.md.

    Args:
        root: folders that may be used; relative paths start at the first.
        jobs: commands that run at a time; further calls wait.
    """
    roots = Roots(root)
    if jobs < 1:
        raise RealsimError("--jobs is too small", expected="at least 1", found=str(jobs))
    from realsim.cli.mcp_server import build

    build(roots, jobs).run("stdio")
    return CommandResult("")
