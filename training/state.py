"""A base's training state without its weights, which ship already: the file that is kept, and the checkpoint again.

    python training/state.py split base/policy.pt g1    training/g1/state.pt.xz, and the policy where it ships
    python training/state.py join base/policy.pt g1     the checkpoint from both, for `realsim pretrain --resume`

Of the optimiser's moments the second are kept, in bfloat16. The first forget within one iteration: without them the
next update of G1 moved the policy by a KL divergence of 0.022 instead of 0.019; without both, by 0.151 (160 worlds, one
seed).
"""

from __future__ import annotations

import hashlib
import io
import lzma
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch
import tyro

from trainer.errors import TrainerError
from trainer.policies import base_of
from trainer.ppo import checkpoint
from trainer.ppo.policy import Policy

HERE = Path(__file__).resolve().parent
STATE = "state.pt.xz"


@dataclass(frozen=True)
class Options:
    do: Annotated[Literal["split", "join"], tyro.conf.Positional]
    file: Annotated[Path, tyro.conf.Positional]
    """The whole checkpoint (.pt)."""
    robot: Annotated[str, tyro.conf.Positional]


def main(options: Options) -> None:
    ships, state = base_of(options.robot), HERE / options.robot / STATE
    if options.do == "split":
        split(options.file, ships, state)
    else:
        join(options.file, ships, state)


def split(whole: Path, ships: Path, state: Path) -> None:
    """Write the policy as it ships, and what else there is to go on from.

    Raises:
        TrainerError: no checkpoint, or one without a training state.
    """
    policy, training = checkpoint.load(whole)
    if training is None:
        raise TrainerError("the checkpoint holds a policy but no training state", file=whole)
    for moments in _moments(training):
        moments["exp_avg_sq"] = moments["exp_avg_sq"].bfloat16()
        del moments["exp_avg"]
    checkpoint.save(ships, policy)
    plain = io.BytesIO()
    torch.save({"policy": fingerprint(policy), "training": training}, plain)
    state.write_bytes(lzma.compress(plain.getvalue()))


def join(whole: Path, ships: Path, state: Path) -> None:
    """Write the checkpoint from which training goes on.

    Raises:
        TrainerError: the state is that of another policy than the one that ships.
    """
    policy, _ = checkpoint.load(ships)
    kept: dict[str, Any] = torch.load(
        io.BytesIO(lzma.decompress(state.read_bytes())), map_location="cpu", weights_only=True
    )
    if kept["policy"] != fingerprint(policy):
        raise TrainerError("the state belongs to another policy", file=state, expected=f"that of {ships}")
    for moments in _moments(kept["training"]):
        moments["exp_avg"] = torch.zeros_like(moments["exp_avg_sq"])
    checkpoint.save(whole, policy, kept["training"])


def _moments(training: dict[str, Any]) -> list[dict[str, Any]]:
    return list(training["ppo"]["adam"]["state"].values())


def fingerprint(policy: Policy) -> str:
    """Of all weights."""
    digest = hashlib.sha256()
    for network in (policy.actor, policy.critic):
        for name, value in network.state_dict().items():
            digest.update(name.encode() + value.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
