"""`realsim app`: the commands as a page on this machine."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.errors import RealsimError, require


def app(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = Path(),
    port: int = 0,
    open: Annotated[bool, tyro.conf.arg(name="open")] = True,
) -> CommandResult:
    """Open a page in the browser: drop or choose a capture, scan, mesh or recording, start commands, read reports.

    It is served on 127.0.0.1 only, behind a token that is part of the printed address. Ends with Ctrl-C.

    Args:
        folder: what is opened and written lies below it; the current folder by default.
        port: of the page; a free one if 0.
        open: open a browser.
    """
    require("app", "realsim app")
    if not folder.is_dir():
        raise RealsimError("not a folder", file=folder, expected="the folder to work in", hint="check the path")
    from realsim.app.server import serve

    serve(folder, port, open_browser=open)
    return CommandResult("closed")
