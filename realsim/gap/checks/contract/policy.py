"""A policy and its contract: what it sees, in which order and scale, and what its actions mean.

Read from policy.onnx: the metadata of `realsim finetune`, or of mjlab (joint_names, default_joint_pos, action_scale,
joint_stiffness, joint_damping, observation_names); or from deploy.yaml of unitree_rl_lab beside it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from realsim.core.errors import GapError
from realsim.core.files import check_size, read_bytes, read_text
from realsim.core.types import F64

TERMS = {
    "base_ang_vel": "ang_vel", "ang_vel": "ang_vel", "imu_ang_vel": "ang_vel", "gyro": "ang_vel",
    "gravity": "gravity", "projected_gravity": "gravity", "gravity_vec": "gravity",
    "command": "command", "velocity_commands": "command", "commands": "command", "twist": "command",
    "steering_command": "command",
    "joint_pos": "joint_pos", "joint_pos_rel": "joint_pos", "dof_pos": "joint_pos",
    "joint_vel": "joint_vel", "joint_vel_rel": "joint_vel", "dof_vel": "joint_vel",
    "last_action": "last_action", "actions": "last_action", "prev_actions": "last_action",
}  # fmt: skip
"""Names of observation terms -> what they hold."""


@dataclass(frozen=True)
class Term:
    """One part of the observation vector."""

    name: str
    kind: str
    """A value of TERMS."""
    width: int
    """Of one moment."""
    history: int = 1
    scale: float = 1.0


@dataclass(frozen=True)
class Contract:
    """The contract of a policy; J joints in the policy's own order."""

    joints: tuple[str, ...]
    terms: tuple[Term, ...]
    default: F64 = field(repr=False)
    """(J,) rad: target = default + scale * action."""
    scale: F64 = field(repr=False)
    kp: F64 = field(repr=False)
    kd: F64 = field(repr=False)
    period: float = 0.02
    clip: float | None = None
    run: Any = field(default=None, repr=False)
    """(N, A) observations -> (N, J) actions."""

    @property
    def width(self) -> int:
        return sum(t.width * t.history for t in self.terms)


def load_policy(path: Path, deploy: Path | None = None, joints: Sequence[str] = ()) -> Contract:
    """The contract of a policy.

    Args:
        path: policy.onnx.
        deploy: deploy.yaml of unitree_rl_lab, where the ONNX file has no metadata.
        joints: names of the motors in the robot's order, which deploy.yaml does not know; those of the log.

    Raises:
        GapError: no ONNX, no contract in it, or one that does not fit the network.
    """
    session = _session(path)
    inputs = session.get_inputs()
    if len(inputs) != 1:
        raise GapError(
            "the policy has more inputs than a vector", file=path, expected="one input of proprioception",
            found=", ".join(i.name for i in inputs), hint="policies with a camera cannot be replayed from such logs",
        )  # fmt: skip
    meta = session.get_modelmeta().custom_metadata_map
    try:
        if deploy is not None:
            made = _of_deploy_yaml(yaml.safe_load(read_text(deploy)), joints)
        elif "realsim" in meta:
            made = _of_realsim(json.loads(meta["realsim"]))
        elif "joint_names" in meta:
            made = _of_mjlab(meta)
        else:
            raise GapError(
                "the policy does not describe its observations", file=path,
                expected="metadata of realsim or mjlab, or --deploy-yaml", found=", ".join(meta) or "no metadata",
            )  # fmt: skip
    except (KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
        raise GapError(
            "the policy's contract cannot be read", file=deploy or path, found=f"{type(error).__name__}: {error}"
        ) from error
    size = inputs[0].shape[-1]
    if isinstance(size, int) and size != made.width:
        raise GapError(
            "the contract does not fit the network", file=path, expected=f"{size} numbers of observation",
            found=" + ".join(f"{t.history} x {t.width} {t.name}" for t in made.terms),
        )  # fmt: skip
    name = inputs[0].name

    def run(rows: F64) -> F64:
        return np.asarray(session.run(None, {name: rows.astype(np.float32)})[0], dtype=np.float64)

    from dataclasses import replace

    return replace(made, run=run)


def _session(path: Path) -> Any:
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    check_size(path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(read_bytes(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own exception classes share no base but this
        raise GapError("not a readable ONNX policy", file=path, found=str(error).partition("\n")[0]) from error


def _terms(names: Mapping[str, tuple[int, float]] | Sequence[tuple[str, int, float]], joints: int) -> tuple[Term, ...]:
    """Terms from (name, whole width or history, scale); a negative width is a history."""
    items = [(n, *v) for n, v in names.items()] if isinstance(names, Mapping) else list(names)
    found = []
    for name, size, scale in items:
        kind = TERMS.get(name)
        if kind is None:
            raise ValueError(f"unknown observation term {name!r}: known are {', '.join(TERMS)}")
        width = 3 if kind in ("ang_vel", "gravity", "command") else joints
        if size > 0 and size % width:
            raise ValueError(f"{name} is {size} wide, which is no multiple of {width}")
        found.append(Term(name, kind, width, -size if size < 0 else size // width, scale))
    return tuple(found)


def _array(values: Any, count: int) -> F64:
    found = np.broadcast_to(np.asarray(values, dtype=np.float64), (count,)).copy()
    if not np.isfinite(found).all():
        raise ValueError("a figure is not finite")
    return found


def _of_realsim(facts: Mapping[str, Any]) -> Contract:
    layout = facts["layout"]
    joints = tuple(layout["actions"])
    n = len(joints)
    terms = _terms([(name, int(width), 1.0) for name, width in layout["actor"]], n)
    return Contract(
        joints, terms, _array(facts["default"], n), _array(facts["action_scale"], n), _array(facts["kp"], n),
        _array(facts["kd"], n), float(facts["policy_dt"]), facts.get("action_limit"),
    )  # fmt: skip


def _of_mjlab(meta: Mapping[str, str]) -> Contract:
    joints = tuple(meta["joint_names"].split(","))
    n = len(joints)

    def numbers(key: str) -> F64:
        return _array([float(v) for v in meta[key].split(",")], n)

    terms = _terms([(name.strip(), -1, 1.0) for name in meta["observation_names"].split(",")], n)
    scale = [float(v) for v in meta["action_scale"].split(",")]
    return Contract(
        joints, terms, numbers("default_joint_pos"), _array(scale if len(scale) == n else scale[0], n),
        numbers("joint_stiffness"), numbers("joint_damping"), float(meta.get("step_dt", 0.02)),
    )  # fmt: skip


def _of_deploy_yaml(said: Mapping[str, Any], motors: Sequence[str]) -> Contract:
    """deploy.yaml: lists in the policy's order; `joint_ids_map` is the motor of each of the policy's joints."""
    ids = [int(i) for i in said["joint_ids_map"]]
    if max(ids) >= len(motors):
        raise ValueError(f"joint_ids_map names motor {max(ids)}, the log has {len(motors)} joints")
    n = len(ids)
    ((_, action),) = said["actions"].items()
    sizes = {}
    for name, term in said["observations"].items():
        scale = np.unique(np.atleast_1d(term.get("scale") if term.get("scale") is not None else 1.0))
        if len(scale) > 1:
            raise ValueError(f"{name} has a scale per column")
        sizes[name] = (-int(term.get("history_length") or 1), float(scale[0]))
    clip = action.get("clip")
    limit = float(np.max(np.abs(clip))) if clip is not None else None
    return Contract(
        tuple(motors[i] for i in ids), _terms(sizes, n), _array(said["default_joint_pos"], n),
        _array(action["scale"], n), _array(said["stiffness"], n), _array(said["damping"], n), float(said["step_dt"]),
        limit,
    )  # fmt: skip
