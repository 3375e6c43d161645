"""`realsim inspect`: how a capture is recognised, before anything is computed from it."""

from pathlib import Path
from typing import Annotated

import tyro

from realsim import capture
from realsim.capture.config import CaptureConfig
from realsim.cli.commands import CommandResult


def inspect(frames: Annotated[Path, tyro.conf.Positional], config: CaptureConfig) -> CommandResult:
    """Say how a capture was recognised, every convention assumed, what is in it, and what is wrong with it.

    Args:
        frames: a capture folder or a scan.
    """
    found = capture.inspect(frames, config)
    return CommandResult(found.render(), found.as_dict())
