"""`realsim mcp`: realsim as tools for agents, over the Model Context Protocol."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.cli.roots import Roots
from realsim.core.errors import RealsimError


def mcp(
    root: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = (), jobs: int = 1, minutes: float = 60.0
) -> CommandResult:
    """Serve inspect, reconstruct, contact, export, diagnose and report to an agent, over standard input and output.

    Nothing outside the folders is read or written, wherever links lead. See docs/agents.md.

    Args:
        root: folders that may be used; relative paths start at the first.
        jobs: commands that run at a time; further calls wait.
        minutes: that a call may take before its command is ended.
    """
    roots = Roots(root)
    if jobs < 1:
        raise RealsimError("--jobs is too small", expected="at least 1", found=str(jobs))
    if not 0 < minutes < float("inf"):
        raise RealsimError("--minutes is no time", expected="more than 0", found=f"{minutes:g}")
    from realsim.cli.mcp_server import build

    build(roots, jobs, 60 * minutes).run("stdio")
    return CommandResult("")
