"""The state of training on disk: one file with weights and the optimiser's moments, read without running code."""

import io
import pickle
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from realsim.core.errors import RealsimError
from realsim.core.files import read_bytes, write_bytes
from training.pointmap.network import PointmapNet, Shape

FORMAT = "realsim-pointmap, version 2"
FILE = "state.pt"
MAX_BYTES = 2**30


@dataclass
class State:
    """A network and how far its training has come."""

    net: PointmapNet
    step: int = 0
    """Optimiser steps so far."""
    views: int = 0
    """Pictures seen so far."""
    minutes: float = 0.0
    """Of training so far."""
    moments: dict[int, dict[str, Any]] = field(default_factory=dict)
    """The optimiser's `state`; empty where it was not kept."""


def save(folder: Path, state: State, optimiser: torch.optim.Optimizer | None = None) -> Path:
    """Write the state; the one before is replaced when the new one is complete."""
    data = {
        "format": FORMAT, "shape": asdict(state.net.shape), "step": state.step, "views": state.views,
        "minutes": state.minutes, "weights": state.net.state_dict(),
        "moments": {} if optimiser is None else optimiser.state_dict()["state"],
    }  # fmt: skip
    buffer = io.BytesIO()
    torch.save(data, buffer)
    write_bytes(folder / FILE, buffer.getvalue())
    return folder / FILE


def load(folder: Path) -> State:
    """The state in a folder, on the CPU.

    Raises:
        RealsimError: not there, damaged, of another version, or weights that are not numbers.
    """
    file = folder / FILE
    content = io.BytesIO(read_bytes(file, MAX_BYTES))
    try:
        data = torch.load(content, map_location="cpu", weights_only=True)
        if data["format"] != FORMAT:
            raise RealsimError("not a state of this training", file=file, expected=FORMAT, found=str(data["format"]))
        net = PointmapNet(Shape(**{**data["shape"], "stem": tuple(data["shape"]["stem"])}))
        net.load_state_dict(data["weights"])
        found = State(net, int(data["step"]), int(data["views"]), float(data["minutes"]), dict(data["moments"]))
    except (pickle.UnpicklingError, KeyError, AttributeError, RuntimeError, TypeError, ValueError) as error:
        raise RealsimError(
            "the state cannot be used", file=file, found=str(error).splitlines()[0],
            hint="it is damaged, or was written by a changed version of the network",
        ) from error  # fmt: skip
    if strange := [n for n, p in net.named_parameters() if not bool(p.isfinite().all())]:
        raise RealsimError("weights that are not numbers", file=file, found=", ".join(strange[:3]))
    return found


def restore(state: State, optimiser: torch.optim.Optimizer) -> bool:
    """Give an optimiser of `state.net` its moments back; False where they were not kept."""
    if state.moments:
        optimiser.load_state_dict({**optimiser.state_dict(), "state": state.moments})
    return bool(state.moments)
