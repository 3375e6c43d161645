"""Checkpoints: written whole or not at all, read without unpickling code, refused with a reason."""

import io
import pickle
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from realsim.core.files import archive_damage, check_size, write_bytes
from realsim.core.recognise import recognise
from trainer.errors import TrainerError
from trainer.fields import filled
from trainer.ppo import policy as policies
from trainer.ppo.config import NetworkConfig, StrategyConfig
from trainer.ppo.policy import Policy
from trainer.tasks import ObservationLayout

FORMAT, VERSION = "realsim-policy", 1
MAX_BYTES = 2 * 2**30


def save(path: Path, policy: Policy, training: Mapping[str, Any] | None = None, latest: Policy | None = None) -> None:
    """Write a policy, with the state of its training if it is to be resumed.

    Args:
        path: the .pt file; replaced only when the new one is complete.
        policy: what it sees and what it has learnt.
        training: tensors and plain values only; see `trainer.ppo.runner`.
        latest: the policy with which the training goes on, where that is another than the one to be used.
    """
    data = {
        "format": FORMAT,
        "version": VERSION,
        "robot": policy.robot,
        "layout": asdict(policy.layout),
        "networks": asdict(policy.networks),
        **_weights(policy),
        "training": None if training is None else dict(training),
        "latest": None if latest is None else _weights(latest),
    }
    buffer = io.BytesIO()
    torch.save(data, buffer)
    write_bytes(path, buffer.getvalue())


def load(path: Path, device: str | torch.device = "cpu", latest: bool = False) -> tuple[Policy, dict[str, Any] | None]:
    """The policy of a checkpoint and, if it has one, the state of its training.

    Args:
        path: the .pt file.
        device: where its weights go.
        latest: the policy with which the training goes on, instead of the one to be used.

    Raises:
        TrainerError: missing, cut off, not a checkpoint, of another version, or not what its header says.
    """
    data = read(path)
    try:
        layout = filled(ObservationLayout, data["layout"], "field of the layout", path)
        networks = filled(NetworkConfig, data["networks"], "size of the networks", path)
        policy = policies.new(layout, networks, str(data["robot"]), 0)
        weights = (latest and data.get("latest")) or data
        for name, config in weights["tuned"]:
            policy = policies.fine_tune(policy, str(name), filled(StrategyConfig, config, "option", path))
        policy.actor.load_state_dict(weights["actor"])
        policy.critic.load_state_dict(weights["critic"])
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise TrainerError(
            "the checkpoint's contents do not fit together",
            file=path,
            found=f"{type(error).__name__}: {_line(error)}",
            hint="it was edited, or written by a changed version of the networks",
        ) from error
    _refuse_what_is_not_a_number(path, policy)
    return policy.to(torch.device(device)), data["training"]


def deliver(path: Path, policy: Policy) -> None:
    """Put another policy of the same robot into a checkpoint; the training goes on where it was.

    Raises:
        TrainerError: see `load`.
    """
    went_on, training = load(path, latest=True)
    save(path, policy, training, None if training is None else went_on)


def _weights(policy: Policy) -> dict[str, Any]:
    return {
        "tuned": [(name, asdict(config)) for name, config in policy.tuned],
        "actor": policy.actor.state_dict(),
        "critic": policy.critic.state_dict(),
    }


def read(path: Path) -> dict[str, Any]:
    """The dictionary of a checkpoint, on the CPU, after its format and version were checked."""
    kind = recognise(path)
    if kind is not None and kind.name != "checkpoint":
        raise TrainerError(
            "not a policy",
            file=path,
            expected="policy.pt of a training, or its policy.onnx",
            found=kind.what,
            hint=kind.way_out(path),
        )
    check_size(path, MAX_BYTES)
    if (damage := archive_damage(path)) is not None:
        raise _damaged(path, damage)
    try:
        data = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise TrainerError(
            "not a policy checkpoint",
            file=path,
            expected="tensors and plain values (it is read without running code)",
            found=_line(error),
        ) from error
    except Exception as error:  # of damage, torch's reader raises whatever it meets
        raise _damaged(path, f"{path.stat().st_size} bytes; {_line(error)}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise TrainerError(
            "not a policy checkpoint of realsim", file=path, expected=f"format {FORMAT}", found=_brief(data)
        )
    if data.get("version") != VERSION:
        raise TrainerError(
            "the checkpoint was written by another version",
            file=path,
            expected=f"version {VERSION}",
            found=f"version {data.get('version')}",
            hint="use the release that wrote it, or train again",
        )
    return data


def _damaged(path: Path, found: str) -> TrainerError:
    return TrainerError(
        "the checkpoint cannot be read: it is cut off or damaged",
        file=path,
        expected="a complete .pt file",
        found=found,
        hint="copy it again, or use the checkpoint before it",
    )


def _refuse_what_is_not_a_number(path: Path, policy: Policy) -> None:
    """Such a policy acts, and is trained on, without a word: the physics only sees joints that are told nothing."""
    for part, network in (("actor", policy.actor), ("critic", policy.critic)):
        for name, value in network.state_dict().items():
            if value.is_floating_point() and not bool(value.isfinite().all()):
                raise TrainerError(
                    "the policy's weights are not all numbers",
                    file=path,
                    expected="finite weights",
                    found=f"{part}.{name}: {int((~value.isfinite()).sum())} of {value.numel()} are not",
                    hint="its training diverged; use a checkpoint before it",
                )


def _line(error: BaseException) -> str:
    """The first line of what another library says, and the second where the first only announces it."""
    lines = [line.strip() for line in str(error).splitlines()] or [type(error).__name__]
    return " ".join(lines[:2] if lines[0].endswith(":") else lines[:1])


def _brief(data: Any) -> str:
    return f"keys {', '.join(map(str, list(data)[:6]))}" if isinstance(data, dict) else type(data).__name__
