"""A policy as ONNX: one file that a robot can run, with all that it must know about it in the metadata."""

import io
import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from realsim.core.errors import ModelError, extra
from realsim.core.files import write_bytes
from realsim.core.onnx_file import open_network, open_session
from trainer.errors import TrainerError
from trainer.ppo.config import NetworkConfig
from trainer.ppo.metadata import Deployment, check_graph, check_network, read_metadata
from trainer.ppo.networks import Critic
from trainer.ppo.policy import Policy
from trainer.robots import TrainedRobot
from trainer.tasks import ObservationLayout

KEY, VERSION = "realsim", 1
OPSET = 18
"""What runtimes have read since 2023."""
EXPORTED = "`realsim finetune` and `realsim pretrain` write policy.onnx beside policy.pt"
TOLERANCE = 1e-5
"""Largest difference between torch and the runtime that an export may have, of actions of order one."""


def deployment(
    policy: Policy,
    robot: TrainedRobot,
    policy_dt: float,
    depth_range: tuple[float, float] = (0.0, 0.0),
    action_limit: float | None = None,
) -> Deployment:
    """The metadata of a policy."""

    def numbers(x: np.ndarray) -> tuple[float, ...]:
        return tuple(map(float, x))

    return Deployment(
        policy.layout,
        policy.robot,
        policy_dt,
        default=numbers(robot.default),
        action_scale=numbers(robot.action_scale),
        kp=numbers(robot.kp),
        kd=numbers(robot.kd),
        depth_near=depth_range[0],
        depth_far=depth_range[1],
        tuned=tuple(name for name, _ in policy.tuned),
        action_limit=action_limit,
    )


def export(path: Path, policy: Policy, facts: Deployment, checks: int = 64) -> float:
    """Write `path` after the runtime has given what torch gives; the largest difference seen.

    Inputs are `vector` (N, A) and, with a camera, `depth` (N, M, H, W); the output is `action` (N, J), the mean.

    Raises:
        TrainerError: the exported network computes something else, or cannot be written; nothing is written.
        MissingExtraError: onnx is not installed.
    """
    extra("onnx", "train", "exporting a policy to ONNX")
    actor = policy.actor.to("cpu").eval()
    vector, depth = _examples(policy.layout, checks)
    given = {"vector": vector} if depth is None else {"vector": vector, "depth": depth}
    data = _annotated(_written(path, actor, (vector, depth), given), facts)
    with torch.no_grad():
        expected = actor(vector, depth).numpy()
    (found,) = open_session(path, data).run(None, {name: value.numpy() for name, value in given.items()})
    error = float(np.abs(found - expected).max() / max(1.0, float(np.abs(expected).max())))
    if not error <= TOLERANCE:
        raise TrainerError(
            "the exported policy does not compute what the trained one does",
            file=path,
            expected=f"a difference of at most {TOLERANCE:g}",
            found=f"{error:g}",
        )
    write_bytes(path, data)
    return error


def load(path: Path | str) -> tuple[Any, Deployment]:
    """(onnxruntime session, metadata) of an exported policy.

    Raises:
        TrainerError: not ONNX, cut off, not exported by `export`, of another version, or with metadata that do not fit
            each other or the network; or a network that fails on zeros.
    """
    path = Path(path)
    try:
        runtime = open_network(path)
    except ModelError as error:
        raise TrainerError(
            f"the policy cannot be read: {error.message}", file=path, expected=error.expected, found=error.found,
            hint=error.hint or EXPORTED,
        ) from error  # fmt: skip
    meta = runtime.get_modelmeta().custom_metadata_map
    if KEY not in meta:
        raise TrainerError(
            "the ONNX file does not describe its observations",
            file=path,
            expected=f"metadata {KEY!r}, as `realsim finetune` writes it",
            found=f"metadata {sorted(meta)}",
            hint=f"{EXPORTED}; those of mjlab, Isaac Lab and Unitree: realsim diagnose LOG --policy {path}",
        )
    facts = read_metadata(meta[KEY], VERSION, path)
    check_graph(runtime, facts.layout, path)
    check_network(runtime, facts.layout, path)
    return runtime, facts


class _Runtime(torch.nn.Module):
    """An exported network in the place of the actor that it was."""

    def __init__(self, runtime: Any) -> None:
        super().__init__()
        self.runtime = runtime

    def forward(self, vector: torch.Tensor, depth: torch.Tensor | None) -> torch.Tensor:
        given = {"vector": vector} if depth is None else {"vector": vector, "depth": depth}
        (action,) = self.runtime.run(None, {name: value.cpu().numpy() for name, value in given.items()})
        return torch.from_numpy(action).to(vector.device)


def as_policy(path: Path, robot: Callable[[str, Path], TrainedRobot]) -> Policy:
    """An exported policy for trials: the network that a robot runs, without a critic, so it cannot be trained.

    Args:
        path: policy.onnx.
        robot: finds a robot by its name; the file is for the message.

    Raises:
        TrainerError: as `load`; or its pose, action scale or gains are not the robot's, which trials take.
    """
    runtime, facts = load(path)
    body = robot(facts.robot, path)
    for name in ("default", "action_scale", "kp", "kd"):
        if not np.allclose(mine := getattr(facts, name), own := getattr(body, name), rtol=1e-4, atol=1e-6):
            j = int(np.argmax(np.abs(np.subtract(mine, own))))
            raise TrainerError(
                f"the policy was trained with another {name} than the robot {facts.robot} has here",
                file=path,
                expected=f"{own[j]:g} at {body.joints[j]}",
                found=f"{mine[j]:g}",
                hint="the robot's file has changed since: restore it, or train again",
            )
    return Policy(_Runtime(runtime), Critic(facts.layout, NetworkConfig()), facts.layout, NetworkConfig(), facts.robot)


def _examples(layout: ObservationLayout, rows: int) -> tuple[torch.Tensor, torch.Tensor | None]:
    rng = torch.Generator().manual_seed(0)
    vector = torch.randn(rows, layout.actor_width, generator=rng)
    return vector, None if layout.depth is None else torch.rand(rows, *layout.depth, generator=rng)


def _written(path: Path, actor: torch.nn.Module, inputs: tuple[Any, ...], names: Mapping[str, Any]) -> bytes:
    """The network as ONNX for any number of rows, by the exporter of torch that needs no further package."""
    data = io.BytesIO()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that there is another exporter
            torch.onnx.export(
                actor, inputs, data,  # type: ignore[arg-type] # this one takes a buffer
                input_names=[*names], output_names=["action"], opset_version=OPSET,
                dynamic_axes={name: {0: "batch"} for name in (*names, "action")}, dynamo=False,
            )  # fmt: skip
    except (RuntimeError, ValueError) as error:
        raise TrainerError(
            "the policy cannot be written as ONNX",
            file=path,
            expected="a network of operations that torch.onnx has",
            found=str(error).partition("\n")[0],
        ) from error
    return data.getvalue()


def _annotated(data: bytes, facts: Deployment) -> bytes:
    model = extra("onnx", "train", "exporting a policy to ONNX").load_model_from_string(data)
    entry = model.metadata_props.add()
    entry.key, entry.value = KEY, json.dumps({"version": VERSION, **asdict(facts)})
    return model.SerializeToString()
