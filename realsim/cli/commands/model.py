"""`realsim model inspect`: how a feed-forward model in an ONNX file fits the contract."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from realsim.cli.commands import CommandResult
from realsim.feedforward.onnx.inspect import inspect_model


def model(
    what: Annotated[Literal["inspect"], tyro.conf.Positional],
    file: Annotated[Path, tyro.conf.Positional],
    provider: str | None = None,
    trial: Annotated[bool, tyro.conf.arg(name="run-on-noise")] = True,
) -> CommandResult:
    """Say how a model file fits the contract (docs/models.md): kind, what is read from the file and what is guessed,
    and which numbers of views and sizes really run.

    Args:
        what: inspect.
        file: the ONNX file.
        provider: execution provider of onnxruntime (default: the fastest that is installed).
        trial: run the model on noise.
    """
    found = inspect_model(file, provider, trial=trial)
    return CommandResult(found.render(), found.as_dict(), 0 if found.fits else 1)
