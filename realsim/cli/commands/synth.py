"""`realsim synth`: a synthetic capture with its truth."""

from pathlib import Path

from realsim.cli.commands import CommandResult
from realsim.synth.config import SynthConfig


def synth(config: SynthConfig, out: Path = Path("synth"), overwrite: bool = False) -> CommandResult:
    """Render a synthetic RGB-D capture of a parkour terrain, and keep the exact truth beside it.

    Args:
        out: gets capture/ (what `realsim reconstruct` reads) and truth/ (which it must not see).
        overwrite: replace a folder that realsim wrote before.
    """
    from realsim.synth.capture import write_capture

    made = write_capture(out, config, overwrite=overwrite)
    return CommandResult(
        f"capture {made.capture}\ntruth   {made.truth}", {"capture": str(made.capture), "truth": str(made.truth)}
    )
