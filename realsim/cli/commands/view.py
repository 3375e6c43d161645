"""`realsim view`: a scene in the browser, live."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.recognise import whole


def view(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")], port: int = 8080
) -> CommandResult:
    """Open a live viewer with toggles for frames, cloud, mesh, collision geometry and platforms; ends with Ctrl-C.

    Args:
        scene: a folder made by `realsim reconstruct`.
        port: where the page is served on this machine; the next free one if it is taken.
    """
    from realsim.report.live import view as serve

    serve(whole(scene), port)
    return CommandResult("closed")
