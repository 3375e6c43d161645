"""A base's training state without its weights, which ship already: the file that is kept, and the checkpoint again.

    python training/state.py split base/policy.pt g1    training/g1/state.pt.xz, and the policy where it ships
    python training/state.py join base/policy.pt g1     the checkpoint from both, for `realsim pretrain --resume`
    python training/state.py join base/policy.pt quadruped --robot-of go2   the same, to go on with another robot
    python training/state.py curve base/history.jsonl go2  every tenth iteration into training/go2/curve.csv

Of the optimiser's moments the second are kept, in bfloat16. The first forget within one iteration: without them the
next update of G1 moved the policy by a KL divergence of 0.022 instead of 0.019; without both, by 0.151 (160 worlds, one
seed).
"""

import hashlib
import io
import lzma
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch
import tyro

from trainer.errors import TrainerError
from trainer.policies import base_of
from trainer.ppo import checkpoint
from trainer.ppo.loop import read_rows
from trainer.ppo.policy import Policy
from trainer.terrain import ALL

HERE = Path(__file__).resolve().parent
STATE = "state.pt.xz"


@dataclass(frozen=True)
class Options:
    do: Annotated[Literal["split", "join", "curve"], tyro.conf.Positional]
    file: Annotated[Path, tyro.conf.Positional]
    """The whole checkpoint (.pt); of `curve` a run's history.jsonl."""
    robot: Annotated[str, tyro.conf.Positional]
    robot_of: str = ""
    """The robot to go on with after `join`, if another: one with the same joints, feet and camera image."""


def main(options: Options) -> None:
    state = HERE / options.robot / STATE
    if options.do == "curve":
        state.with_name("curve.csv").write_text("\n".join(curve(options.file.parent)) + "\n")
        return
    ships = base_of(options.robot)
    if options.do == "split":
        split(options.file, ships, state)
    else:
        join(options.file, ships, state, options.robot_of)


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


def join(whole: Path, ships: Path, state: Path, robot: str = "") -> None:
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
    checkpoint.save(whole, replace(policy, robot=robot or policy.robot), kept["training"])


def curve(run: Path) -> list[str]:
    """CSV lines of every tenth iteration of a run's folder: row (0 to 9) and success by family, noise, learning."""
    rows = [r for r in read_rows(run) if "samples" in r]
    named = {f"{f}_{key}": f"env/family/{f}/{key}" for f in ALL for key in ("row", "success")}
    named |= {"success": "env/success", "std": "std", "explained_variance": "explained_variance"}
    lines, seconds = [",".join(["iteration", "samples", "minutes", *named])], 0.0
    for row in rows:
        seconds += (row["collect_s"] or 0.0) + (row["update_s"] or 0.0)
        if (int(row["iteration"] or 0) + 1) % 10 == 0:
            figures = [f"{row[key]:.3f}" if row.get(key) is not None else "" for key in named.values()]
            lines.append(
                ",".join([f"{row['iteration']:.0f}", f"{row['samples']:.0f}", f"{seconds / 60:.2f}", *figures])
            )
    return lines


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
