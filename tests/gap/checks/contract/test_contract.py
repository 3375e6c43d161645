"""A policy that is run wrongly is told from one that is run rightly, and the mistake is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError
from realsim.gap.checks.contract import Contract, Steps, check, load_policy
from realsim.gap.checks.contract.policy import Term
from realsim.gap.checks.contract.steps import Run

JOINTS = tuple(f"{leg}_{joint}_joint" for leg in ("FL", "FR") for joint in ("hip", "thigh", "calf"))
HISTORY = 3
WIDTHS = {"ang_vel": 3, "gravity": 3, "command": 3, "joint_pos": 6, "joint_vel": 6, "last_action": 6}


def make_contract() -> Contract:
    rng = np.random.default_rng(0)
    width = HISTORY * sum(WIDTHS.values())
    weights, out = rng.normal(size=(width, 24)) / np.sqrt(width), rng.normal(size=(24, 6)) / 3

    def run(rows: np.ndarray) -> np.ndarray:
        return np.asarray(np.tanh(rows @ weights) @ out)

    terms = tuple(Term(kind, kind, w, HISTORY) for kind, w in WIDTHS.items())
    default = np.tile([0.1, 0.8, -1.5], 2)
    return Contract(JOINTS, terms, default, np.full(6, 0.25), np.full(6, 40.0), np.full(6, 1.0), run=run)


def loop(
    contract: Contract,
    *,
    see: Callable[[np.ndarray], np.ndarray] = lambda q: q,
    see_vel: Callable[[np.ndarray], np.ndarray] = lambda v: v,
    send: Callable[[np.ndarray], np.ndarray] = lambda t: t,
    gravity: float = 1.0,
    newest_first: bool = False,
    late: int = 0,
    gain: float = 1.0,
    noise: float = 1e-3,
) -> Steps:
    """A loop of its own over made-up readings, step by step, with a mistake in it."""
    rng = np.random.default_rng(1)
    count = 300
    t = 0.02 * np.arange(count)[:, None]
    waves = lambda n, size: size * np.sin(2 * np.pi * rng.uniform(0.3, 2, n) * t + rng.uniform(0, 6, n))  # noqa: E731
    pos, vel, gyro = contract.default + waves(6, 0.3), waves(6, 2.0), waves(3, 0.8)
    tilt = waves(3, 0.2)
    quat = np.concatenate([np.ones((count, 1)), tilt], axis=1)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    told = np.repeat(rng.uniform(-1, 1, (count // 30, 3)), 30, axis=0)
    w, x, y, z = quat.T
    down = -np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    past: dict[str, list[np.ndarray]] = {k: [] for k in WIDTHS}
    action, sent = np.zeros(6), []
    for k in range(count):
        old = max(k - late, 0)
        place, speed = see(pos[old]) - contract.default, see_vel(vel[old])
        now = {"ang_vel": gyro[old], "gravity": gravity * down[old], "command": told[k],
               "joint_pos": place, "joint_vel": speed, "last_action": action}  # fmt: skip
        vector = []
        for kind, value in now.items():
            past[kind] = [value] * HISTORY if not past[kind] else [*past[kind][1:], value]
            vector += past[kind][::-1] if newest_first else past[kind]
        action = contract.run(np.concatenate(vector)[None])[0]
        sent.append(send(contract.default + gain * contract.scale * action))
    command = np.array(sent)
    moved = np.ones(count, bool)
    noisy = [v + rng.normal(0, noise, v.shape) for v in (pos, vel, gyro)]
    return Steps(JOINTS, (Run("run", t[:, 0], command, *noisy, quat, told, moved),), 0.02, 0.02)


def test_a_policy_that_is_run_rightly_is_no_error() -> None:
    contract = make_contract()
    found = check(contract, loop(contract))
    assert found.verdict == "kept"
    assert found.left < 0.02
    assert not found.errors


SIGN = np.array([1, 1, 1, 1, -1, 1.0])
OFFSET = np.array([0, 0, 0.15, 0, 0, 0])


@pytest.mark.parametrize(
    ("kind", "mistake"),
    [
        ("joint_order", {"send": lambda t: t[[3, 4, 5, 0, 1, 2]]}),
        ("joint_order", {"send": lambda t: t[[0, 3, 1, 4, 2, 5]]}),
        ("joint_sign", {"see": lambda q: SIGN * q, "see_vel": lambda v: SIGN * v}),
        ("zero_offset", {"send": lambda t: t + OFFSET}),
        ("zero_offset", {"see": lambda q: q + OFFSET}),
        ("default_pose", {"send": lambda t: t + 0.1 * np.array([1, -1, 1, 1, -1, 1])}),
        ("action_scale", {"gain": 0.5}),
        ("gravity_frame", {"gravity": -1.0}),
        ("history_order", {"newest_first": True}),
        ("observation_delay", {"late": 2}),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_a_mistake_is_named(kind: str, mistake: dict[str, object]) -> None:
    contract = make_contract()
    found = check(contract, loop(contract, **mistake))  # type: ignore[arg-type]
    assert found.verdict in ("broken", "ambiguous")
    assert found.errors[0]["kind"] == kind
    assert found.left > 2 * found.errors[0]["left"]


def test_another_policys_targets_are_not_explained() -> None:
    contract = make_contract()
    steps = loop(contract)
    rng = np.random.default_rng(2)
    strange = replace(steps.runs[0], command=contract.default + 0.2 * rng.normal(size=(300, 6)))
    assert check(contract, replace(steps, runs=(strange,))).verdict == "unexplained"


def test_a_policy_of_another_robot_is_refused() -> None:
    contract = make_contract()
    with pytest.raises(GapError, match="another robot"):
        check(replace(contract, joints=("a", *JOINTS[1:])), loop(contract))


def onnx_policy(path: Path, width: int, meta: dict[str, str]) -> Path:
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")
    from onnx import TensorProto, helper, numpy_helper

    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], ["actions"])], "p",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["n", width])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["n", 6])],
        [numpy_helper.from_array(np.ones((width, 6), np.float32), "w")],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    for key, value in meta.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.save(model, str(path))
    return path


def test_contracts_of_other_tools(tmp_path: Path) -> None:
    six = ",".join(["0.5"] * 6)
    numbers = ("default_joint_pos", "action_scale", "joint_stiffness", "joint_damping")
    seen = "base_ang_vel,projected_gravity,command,joint_pos,joint_vel,actions"
    meta = {"joint_names": ",".join(JOINTS), "observation_names": seen} | dict.fromkeys(numbers, six)
    made = load_policy(onnx_policy(tmp_path / "mjlab.onnx", 27, meta))
    assert made.joints == JOINTS
    assert made.width == 27
    assert made.run(np.ones((2, 27))).shape == (2, 6)

    deploy = {
        "joint_ids_map": [3, 4, 5, 0, 1, 2], "step_dt": 0.02, "stiffness": [40.0] * 6, "damping": [1.0] * 6,
        "default_joint_pos": [0.1] * 6, "actions": {"JointPositionAction": {"scale": [0.25] * 6, "clip": None}},
        "observations": {"base_ang_vel": {"scale": [0.2] * 3, "history_length": 5},
                         "joint_pos_rel": {"scale": [1.0] * 6, "history_length": 5}},
    }  # fmt: skip
    (tmp_path / "deploy.yaml").write_text(json.dumps(deploy))
    bare = onnx_policy(tmp_path / "bare.onnx", 45, {})
    made = load_policy(bare, tmp_path / "deploy.yaml", JOINTS)
    assert made.joints[0] == JOINTS[3]
    assert (made.terms[0].history, made.terms[0].scale) == (5, 0.2)


def test_policies_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "noise.onnx").write_bytes(b"no network")
    with pytest.raises(GapError, match="not a readable ONNX"):
        load_policy(tmp_path / "noise.onnx")
    with pytest.raises(GapError, match="does not describe"):
        load_policy(onnx_policy(tmp_path / "bare.onnx", 27, {}))
    with pytest.raises(GapError, match="cannot be read"):
        load_policy(onnx_policy(tmp_path / "short.onnx", 27, {"joint_names": "a,b"}))
    (tmp_path / "deploy.yaml").write_text("joint_ids_map: [9]\n")
    with pytest.raises(GapError, match="cannot be read"):
        load_policy(tmp_path / "bare.onnx", tmp_path / "deploy.yaml", JOINTS)
