"""Reading a policy: its contract from whichever format has it, and its network, run once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import GapError, ModelError
from realsim.core.onnx_file import open_network
from realsim.core.types import F64
from realsim.gap.checks.contract.formats import read_contract
from realsim.gap.checks.contract.policy import Contract, Run


def load_policy(path: Path, deploy: Path | None = None, joints: Sequence[str] = ()) -> Contract:
    """The contract of a policy.

    Args:
        path: policy.onnx; weights in another file are looked for beside it.
        deploy: deploy.yaml of unitree_rl_lab, or IO_descriptors.yaml of Isaac Lab, where the ONNX file has no metadata.
        joints: names of the motors in the robot's order, which deploy.yaml does not know; those of the log.

    Raises:
        GapError: no ONNX, no contract in it, or one that does not fit the network.
    """
    try:
        session = open_network(path)
    except ModelError as error:
        raise GapError(
            f"not a readable ONNX policy: {error.message}", file=path, expected=error.expected, found=error.found,
            hint=error.hint,
        ) from error  # fmt: skip
    made = read_contract(path, session.get_modelmeta().custom_metadata_map, deploy, joints)
    return replace(made, run=_runner(session, made, path))


def _runner(session: Any, made: Contract, path: Path) -> Run:
    """The network as a function; run once on zeros, so that a damaged one is refused here."""
    inputs = session.get_inputs()
    vector, images = inputs[0], inputs[1:]
    size = vector.shape[-1]
    if isinstance(size, int) and size != made.width:
        raise GapError(
            "the contract does not fit the network", file=path, expected=f"{size} numbers of observation",
            found=f"{made.width}: " + " + ".join(f"{t.history} x {t.width} {t.name}" for t in made.terms),
        )  # fmt: skip
    if len(images) != (made.camera is not None):
        raise GapError(
            "the policy has inputs that its contract does not describe", file=path,
            expected=f"{vector.name}" + (" and a depth image" if made.camera else ""),
            found=", ".join(i.name for i in inputs),
            hint="policies with a clock, a motion reference or a memory of their own cannot be replayed step by step",
        )  # fmt: skip
    single = isinstance(vector.shape[0], int)  # exported for a batch of one

    def call(rows: F64, depth: F64 | None) -> F64:
        feeds = {vector.name: np.ascontiguousarray(rows, np.float32)}
        if made.camera is not None:
            assert depth is not None
            feeds[images[0].name] = np.ascontiguousarray(depth, np.float32)
        if not single:
            return np.asarray(session.run(None, feeds)[0], dtype=np.float64)
        each = [session.run(None, {k: v[i : i + 1] for k, v in feeds.items()})[0][0] for i in range(len(rows))]
        return np.asarray(each, dtype=np.float64).reshape(len(rows), -1)

    try:
        shape = call(np.zeros((1, made.width)), None if made.camera is None else np.ones((1, *made.camera.shape))).shape
    except Exception as error:  # onnxruntime's own exception classes share no base but this
        raise GapError(
            "the policy cannot be run", file=path, expected=f"{len(made.joints)} actions for an observation of zeros",
            found=str(error).partition("\n")[0],
        ) from error  # fmt: skip
    if shape != (1, len(made.joints)):
        raise GapError(
            "the contract does not fit the network", file=path, expected=f"{len(made.joints)} actions",
            found=f"an output of {shape}",
        )  # fmt: skip
    return call
