"""`realsim record`: frames of a RealSense camera, or of a recording, into a folder."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import tyro

from realsim.capture.record import RecordConfig
from realsim.capture.record import record as write
from realsim.cli.commands import CommandResult


def record(out: Annotated[Path, tyro.conf.Positional], config: RecordConfig, bag: Path | None = None) -> CommandResult:
    """Record colour and depth from a RealSense camera until a limit is reached or Ctrl-C is pressed.

    Args:
        out: a folder that does not exist yet; `realsim reconstruct` reads it.
        bag: unpack this recording instead of using a camera.
    """
    made = write(out, config, bag=bag)
    lines = [f"{made.frames} frames in {made.seconds:.1f} s from {made.device}", f"written to {made.folder}"]
    if made.lost:
        lines.append(f"{made.lost} images were lost: this machine is too slow for the size and rate")
    if made.interrupted:
        lines.append("stopped by Ctrl-C: all frames so far are kept")
    return CommandResult("\n".join(lines), {**asdict(made), "folder": str(made.folder)})
