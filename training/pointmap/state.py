"""The state of training on disk: pieces small enough to be carried, an index that names them, read without code.

Two ways of keeping it. `weights`: in half precision only, which is all that the network that ships needs; going on
from it, the optimiser's moments are gathered again while the learning rate warms up. `all`: weights in full and the
moments in bfloat16, four times as large; going on changes nothing but their rounding.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import pickle
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from realsim.core.errors import RealsimError
from realsim.core.files import read_bytes, read_json, write_bytes, write_text
from training.pointmap.network import PointmapNet, Shape

FORMAT, VERSION = "realsim-pointmap", 1
INDEX = "state.json"
PIECE_BYTES = 15 * 2**20
MAX_BYTES = 2**30
KEPT = ("weights", "all")


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
    optimiser: dict[str, dict[str, torch.Tensor]] = field(default_factory=dict)
    """Parameter -> its moments; empty where they were not kept."""


def save(folder: Path, state: State, optimiser: torch.optim.Optimizer | None, keep: str) -> list[Path]:
    """Write the state; the one before is replaced when the new one is complete.

    Returns:
        The files, the index first.
    """
    half = keep == "weights"
    tensors = {n: p.detach().cpu().to(torch.float16 if half else torch.float32) for n, p in _parameters(state.net)}
    data: dict[str, Any] = {"weights": tensors, "moments": {}}
    if not half and optimiser is not None:
        found = {n: optimiser.state[p] for n, p in state.net.named_parameters() if p in optimiser.state}
        data["moments"] = {
            n: {k: v.cpu().to(torch.bfloat16) for k, v in m.items() if k in ("exp_avg", "exp_avg_sq")}
            for n, m in found.items()
        }
    buffer = io.BytesIO()
    torch.save(data, buffer)
    content = buffer.getvalue()
    digest = hashlib.sha256(content).hexdigest()
    count = -(-len(content) // PIECE_BYTES)
    names = [f"state-{digest[:8]}-{k}.bin" for k in range(count)]
    for k, name in enumerate(names):
        write_bytes(folder / name, content[k * PIECE_BYTES : (k + 1) * PIECE_BYTES])
    about = {
        "format": FORMAT, "version": VERSION, "kept": keep, "shape": asdict(state.net.shape), "step": state.step,
        "views": state.views, "minutes": round(state.minutes, 2), "pieces": names, "bytes": len(content),
        "sha256": digest,
    }  # fmt: skip
    write_text(folder / INDEX, json.dumps(about, indent=1) + "\n")
    for old in folder.glob("state-*.bin"):
        if old.name not in names:
            with contextlib.suppress(OSError):
                old.unlink()
    return [folder / INDEX, *(folder / n for n in names)]


def load(folder: Path) -> State:
    """The state in a folder, on the CPU.

    Raises:
        RealsimError: not there, incomplete, damaged, of another version, or weights that are not numbers.
    """
    index = folder / INDEX
    about = read_json(index)
    if not isinstance(about, dict) or (about.get("format"), about.get("version")) != (FORMAT, VERSION):
        raise RealsimError("not a state of this training", file=index, expected=f"{FORMAT}, version {VERSION}")
    try:
        names, digest = [Path(str(n)).name for n in about["pieces"]], str(about["sha256"])
        shape = Shape(**{**about["shape"], "stem": tuple(about["shape"]["stem"])})
        step, views, minutes = int(about["step"]), int(about["views"]), float(about["minutes"])
    except (KeyError, TypeError, ValueError) as error:
        raise RealsimError("the state's index is damaged", file=index, found=str(error)) from error
    content = b"".join(read_bytes(folder / n, MAX_BYTES) for n in names)
    if hashlib.sha256(content).hexdigest() != digest:
        raise RealsimError(
            "the state's pieces are not what its index says", file=index, expected=f"{about.get('bytes')} bytes",
            found=f"{len(content)} bytes, or other ones", hint="copy all pieces again",
        )  # fmt: skip
    net = PointmapNet(shape)
    try:
        data = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        net.load_state_dict({n: v.float() for n, v in data["weights"].items()})
        moments = {n: dict(m) for n, m in data["moments"].items()}
    except (pickle.UnpicklingError, KeyError, AttributeError, RuntimeError, TypeError) as error:
        raise RealsimError(
            "the state does not fit the network", file=index, found=str(error).splitlines()[0],
            hint="it was written by a changed version of the network",
        ) from error  # fmt: skip
    if strange := [n for n, p in net.named_parameters() if not bool(p.isfinite().all())]:
        raise RealsimError("weights that are not numbers", file=index, found=", ".join(strange[:3]))
    return State(net, step, views, minutes, moments)


def restore(state: State, optimiser: torch.optim.Optimizer) -> bool:
    """Give an optimiser of `state.net` its moments back; False where they were not kept."""
    if not state.optimiser:
        return False
    for name, p in state.net.named_parameters():
        if name in state.optimiser:
            optimiser.state[p] = {
                "step": torch.tensor(float(state.step)),
                **{k: v.to(p.device, torch.float32) for k, v in state.optimiser[name].items()},
            }
    return True


def _parameters(net: nn.Module) -> list[tuple[str, torch.Tensor]]:
    return list(net.state_dict().items())
