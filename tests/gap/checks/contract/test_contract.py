"""A policy that is run wrongly is distinguished from one that is run rightly, and its mistakes are named."""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from realsim.core.errors import GapError, RealsimError
from realsim.core.onnx_file import open_session, with_any_batch
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

    def run(rows: np.ndarray, depth: np.ndarray | None) -> np.ndarray:
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
    kept: int = 0,
    gain: float | np.ndarray = 1.0,
    told: float | np.ndarray = 1.0,
    noise: float | tuple[float, float, float] = 1e-3,
    alpha: float = 1.0,
    shown: float = 0.0,
    quick: int = 0,
) -> Steps:
    """A loop of its own over made-up readings, step by step, with a mistake in it."""
    rng = np.random.default_rng(1)
    count = 240
    t = 0.02 * np.arange(count)[:, None]
    waves = lambda n, size: size * np.sin(2 * np.pi * rng.uniform(0.3, 2, n) * t + rng.uniform(0, 6, n))  # noqa: E731
    rate, phase = 2 * np.pi * rng.uniform(0.3, 2, 6), rng.uniform(0, 6, 6)
    rate[:quick] = 2 * np.pi * rng.uniform(21, 24, quick)  # they turn back between two rows
    pos, vel = contract.default + 0.3 * np.sin(rate * t + phase), 0.3 * rate * np.cos(rate * t + phase)
    gyro = waves(3, 0.8)
    tilt = waves(3, 0.2)
    quat = np.concatenate([np.ones((count, 1)), tilt], axis=1)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    asked = told * np.repeat(rng.uniform(-1, 1, (count // 30, 3)), 30, axis=0)
    w, x, y, z = quat.T
    down = -np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    past: dict[str, list[np.ndarray]] = {k: [] for k in WIDTHS}
    action, sent, vectors = np.zeros(6), [], list[np.ndarray]()
    for k in range(count):
        old = max(k - late, 0)
        place, speed = see(pos[old]) - contract.default, see_vel(vel[old])
        now = {"ang_vel": gyro[old], "gravity": gravity * down[old], "command": asked[k],
               "joint_pos": place, "joint_vel": speed, "last_action": action}  # fmt: skip
        vector = []
        for term in contract.terms:
            kind, value = term.kind, now[term.kind] * term.scale
            past[kind] = [value] * HISTORY if not past[kind] else [*past[kind][1:], value]
            vector += past[kind][::-1] if newest_first else past[kind]
        vectors.append(np.concatenate(vector))
        action = contract.run(vectors[max(k - kept, 0)][None], None)[0]
        wanted = send(contract.default + gain * contract.scale * action)
        sent.append(wanted if not sent else alpha * wanted + (1 - alpha) * sent[-1])
        action = (1 - shown) * action + shown * (sent[-1] - contract.default) / contract.scale
    command = np.array(sent)
    moved = np.ones(count, bool)
    sizes = np.broadcast_to(noise, 3)
    noisy = [v + rng.normal(0, size, v.shape) for v, size in zip((pos, vel, gyro), sizes, strict=True)]
    return Steps(JOINTS, (Run("run", t[:, 0], command, *noisy, quat, asked, moved),), 0.02, 0.02)


def test_a_policy_that_is_run_rightly_is_no_error() -> None:
    contract = make_contract()
    found = check(contract, loop(contract))
    assert found.verdict == "kept"
    assert found.left < 0.02
    assert not found.errors


SIGN = np.array([1, 1, 1, 1, -1, 1.0])
OFFSET = np.array([0, 0, 0.15, 0, 0, 0])
ONE = np.array([1, 0.64, 1, 1, 1, 1])
DEFAULT = np.tile([0.1, 0.8, -1.5], 2)


@pytest.mark.parametrize(
    ("kinds", "mistake"),
    [
        ({"joint_order"}, {"send": lambda t: t[[3, 4, 5, 0, 1, 2]]}),
        ({"joint_order"}, {"see_vel": lambda v: v[[0, 3, 1, 4, 2, 5]]}),
        ({"joint_sign"}, {"see": lambda q: SIGN * q, "see_vel": lambda v: SIGN * v}),
        ({"zero_offset"}, {"see": lambda q: q + OFFSET}),
        ({"default_pose"}, {"send": lambda t: t + 0.1 * np.array([1, -1, 1, 1, -1, 1])}),
        ({"action_scale"}, {"gain": 0.5}),
        ({"action_scale"}, {"gain": ONE}),
        ({"observation_scale"}, {"see_vel": lambda v: 0.25 * v}),
        ({"gravity_frame"}, {"gravity": -1.0}),
        ({"history_order"}, {"newest_first": True}),
        ({"sensor_delay"}, {"late": 2}),
        ({"sensor_delay"}, {"kept": 1}),
        ({"action_filter"}, {"alpha": 0.3}),
        ({"action_filter"}, {"alpha": 0.7, "shown": 1.0}),
        ({"action_filter", "sensor_delay"}, {"alpha": 0.5, "late": 1}),
        ({"clipped_target"}, {"send": lambda t: np.clip(t, DEFAULT - 0.02, DEFAULT + 0.04)}),
        ({"clipped_target"}, {"send": lambda t: np.clip(t, DEFAULT - 0.03, DEFAULT + 0.03)}),
        ({"gravity_frame", "sensor_delay"}, {"gravity": -1.0, "late": 2}),
        ({"action_scale", "observation_scale"}, {"gain": 0.8, "see_vel": lambda v: 0.05 * v}),
    ],
    ids=lambda v: "+".join(sorted(v)) if isinstance(v, set) else "",
)
def test_mistakes_are_named_one_after_the_other(kinds: set[str], mistake: dict[str, object]) -> None:
    contract = make_contract()
    found = check(contract, loop(contract, **mistake))  # type: ignore[arg-type]
    assert found.verdict in ("broken", "ambiguous")
    assert {e["kind"] for e in found.errors} == kinds
    assert found.left > 2 * found.after
    assert all(e["setting"] for e in found.errors)


def test_a_low_pass_of_the_contract_is_looked_for_in_the_log() -> None:
    contract = replace(make_contract(), alpha=0.4)
    assert check(contract, loop(contract, alpha=0.4)).verdict == "kept"
    found = check(contract, loop(contract))
    assert [e["kind"] for e in found.errors] == ["action_filter"]
    assert "(alpha 0.4) is not in what is logged" in found.sentence


def test_a_policy_that_is_run_in_the_robots_own_order_of_joints() -> None:
    order, contract = [2, 5, 0, 1, 4, 3], make_contract()
    see = lambda v: v[order]  # noqa: E731
    steps = loop(contract, see=see, see_vel=see, send=lambda t: t[np.argsort(order)])
    (run,) = steps.runs
    run = replace(run, command=run.command[:, order], pos=run.pos[:, order], vel=run.vel[:, order])
    found = check(contract, replace(steps, joints=tuple(JOINTS[i] for i in order), runs=(run,)))
    assert [e["kind"] for e in found.errors] == ["joint_order"]
    assert "the robot's own" in found.sentence


def logged_between(steps: Steps, times: int) -> Steps:
    """The same loop, logged several times a step: readings change, commands stay constant."""
    (run,) = steps.runs
    rows = np.arange(len(run.time))
    fine = np.arange(times * rows[-1] + 1) / times
    held = fine.astype(int)

    def between(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(fine, rows, column) for column in values.T], axis=1)

    readings = {name: between(getattr(run, name)) for name in ("pos", "vel", "gyro", "quat")}
    run = replace(
        run, time=np.interp(fine, rows, run.time), command=run.command[held], sent=fine == held,
        commanded=run.commanded[held], **readings,
    )  # fmt: skip
    return Steps(steps.joints, (run,), steps.period / times, steps.period)


@pytest.mark.parametrize(
    ("kind", "mistake"),
    [
        ("observation_scale", {"see_vel": lambda v: 0.05 * v}),
        ("gravity_frame", {"gravity": -1.0}),
    ],
)
def test_a_log_faster_than_its_policy(kind: str, mistake: dict[str, object]) -> None:
    contract = make_contract()
    found = check(contract, logged_between(loop(contract, **mistake), 4))  # type: ignore[arg-type]
    assert [e["kind"] for e in found.errors] == [kind]
    assert found.after < 0.005


def test_what_noise_of_the_logs_sensors_explains_is_no_second_mistake() -> None:
    contract = make_contract()
    terms = tuple(replace(t, scale=12.0) if t.kind == "joint_vel" else t for t in contract.terms)
    steps = loop(replace(contract, terms=terms), gravity=-1.0, noise=(5e-4, 0.02, 0.01))
    found = check(replace(contract, terms=terms), steps)
    assert [e["kind"] for e in found.errors] == ["gravity_frame"]


def test_a_command_that_is_never_given_is_not_checked() -> None:
    contract = make_contract()
    assert "never commanded" not in check(contract, loop(contract)).sentence
    found = check(contract, loop(contract, told=np.array([1.0, 0.0, 0.0])))
    assert found.verdict == "kept"
    assert "never commanded left or to turn" in found.sentence


def test_the_period_is_the_logs() -> None:
    contract = make_contract()
    steps = loop(contract)
    fast = steps.each(lambda run: replace(run, time=run.time / 2))
    found = check(contract, replace(fast, period=0.01, changes=0.01))
    assert [e["kind"] for e in found.errors] == ["control_period"]
    assert "every 10 ms instead of every 20 ms" in found.sentence


@pytest.mark.parametrize("quick", [0, 4])
@pytest.mark.parametrize("ratio", [0.8, 1.0])
def test_gains_are_those_of_the_measured_torque_also_where_most_joints_are_too_quick_for_the_log(
    ratio: float, quick: int
) -> None:
    contract = make_contract()

    def driven(run: Run) -> Run:
        torque = ratio * 40.0 * (run.command - run.pos) - 1.0 * run.vel
        return replace(run, torque=torque + np.random.default_rng(3).normal(0, 0.05, torque.shape))

    found = check(contract, loop(contract, quick=quick).each(driven))
    assert [e["kind"] for e in found.errors] == (["gains"] if ratio != 1 else [])
    assert ratio == 1 or found.sentence.count("0.8 times what it should be") == (2 if quick else 1)


def test_a_command_that_is_not_logged_is_estimated() -> None:
    contract = make_contract()
    found = check(contract, loop(contract).each(lambda run: replace(run, commanded=None)))
    assert found.verdict == "kept"
    assert any("velocity command is not logged" in note for note in found.notes)


def test_standing_still_and_short_logs_say_so() -> None:
    contract = make_contract()
    steps = loop(contract)
    rest = steps.each(lambda run: replace(run, command=run.command[:1] + 1e-4 * np.sin(run.time)[:, None]))
    hour = rest.each(lambda run: run.at(np.zeros(180_000, int)))
    hour = hour.each(lambda run: replace(run, time=0.02 * np.arange(180_000.0)))
    resting = replace(contract, run=lambda rows, depth: np.tile((rest.runs[0].command[0] - contract.default) / 0.25,
                                                                  (len(rows), 1)))  # fmt: skip
    assert check(resting, hour).verdict == "still"
    long = replace(contract, terms=(*contract.terms[:-1], replace(contract.terms[-1], history=400)))
    with pytest.raises(GapError, match="history is longer than the log"):
        check(long, steps)


SHARED = Path(os.environ.get("REALSIM_SHARED", Path(__file__).parents[5] / "shared"))
CASES = SHARED / "cases" / "logs" / "contract"


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases of realsim's shared folder are not here")
@pytest.mark.parametrize(
    ("name", "faster", "kinds"),
    [
        ("healthy", 1, []), ("healthy", 2, ["control_period"]), ("C5_rl_sar58_kp20", 1, ["gains"]),
        ("C6_BFMZero17_scale_and_gains", 1, ["action_scale", "gains"]),
    ],
)  # fmt: skip
def test_cases_with_known_answers(name: str, faster: int, kinds: list[str]) -> None:
    with np.load(CASES / f"{name}.npz", allow_pickle=False) as data:
        runs = []
        for i in (0, 1):
            a = {k: data[f"run{i}_{k}"] for k in ("time", "command", "pos", "vel", "gyro", "quat", "told", "torque")}
            sent = np.ones(len(a["time"]), bool)
            arrays = (a["command"], a["pos"], a["vel"], a["gyro"], a["quat"], a["told"])
            runs.append(Run(f"run{i}", a["time"] / faster, *arrays, sent, a["torque"]))
        joints = tuple(str(j) for j in data["joints"])
    period = 0.02 / faster
    found = check(load_policy(CASES / f"{name}.onnx"), Steps(joints, tuple(runs), period, period))
    assert [e["kind"] for e in found.errors] == kinds
    assert found.verdict == ("broken" if kinds else "kept")


def test_another_policys_targets_are_not_explained() -> None:
    contract = make_contract()
    steps = loop(contract)
    rng = np.random.default_rng(2)
    strange = replace(steps.runs[0], command=contract.default + 0.2 * rng.normal(size=(len(steps.runs[0].time), 6)))
    assert check(contract, replace(steps, runs=(strange,))).verdict == "unexplained"


def test_a_policy_of_another_robot_is_refused() -> None:
    contract = make_contract()
    with pytest.raises(GapError, match="another robot"):
        check(replace(contract, joints=("a", *JOINTS[1:])), loop(contract))


NUMBERS = ("default_joint_pos", "action_scale", "joint_stiffness", "joint_damping")
META = {
    "joint_names": ",".join(JOINTS),
    "observation_names": "base_ang_vel,projected_gravity,command,joint_pos,joint_vel,actions",
}
META |= dict.fromkeys(NUMBERS, ",".join(["0.5"] * 6))


def onnx_policy(
    path: Path, width: int, meta: dict[str, str], weights: np.ndarray | None = None, rows: str | int = "n"
) -> Path:
    """A network that multiplies observations by weights (width, joints), ones of six joints if none are given."""
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")
    from onnx import TensorProto, helper, numpy_helper

    weights = np.ones((width, 6), np.float32) if weights is None else weights
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], ["actions"])], "p",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [rows, width])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [rows, weights.shape[1]])],
        [numpy_helper.from_array(weights, "w")],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    for key, value in meta.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.save(model, str(path))
    return path


def test_contracts_of_other_tools(tmp_path: Path) -> None:
    made = load_policy(
        str(onnx_policy(tmp_path / "mjlab.onnx", 27, META | {"action_alpha": "0.4"}))
    )  # paths may be text
    assert made.joints == JOINTS
    assert made.alpha == 0.4
    assert made.width == 27
    assert made.run(np.ones((2, 27)), None).shape == (2, 6)

    deploy = {
        "joint_ids_map": [3, 4, 5, 0, 1, 2], "step_dt": 0.02, "stiffness": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        "damping": [1.0] * 6,
        "default_joint_pos": [0.1] * 6, "actions": {"JointPositionAction": {"scale": [0.25] * 6, "clip": None}},
        "observations": {"base_ang_vel": {"scale": [0.2] * 3, "history_length": 5},
                         "joint_pos_rel": {"scale": [1.0] * 6, "history_length": 5}},
    }  # fmt: skip
    (tmp_path / "deploy.yaml").write_text(json.dumps(deploy))
    bare = onnx_policy(tmp_path / "bare.onnx", 45, {})
    made = load_policy(bare, tmp_path / "deploy.yaml", JOINTS)
    assert made.joints[0] == JOINTS[3]
    assert (made.terms[0].history, made.terms[0].scale) == (5, 0.2)
    assert made.kp.tolist() == [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]  # the file has them in the motors' order

    seen = [{"name": "base_ang_vel", "shape": [3], "overloads": {"history_length": 0, "scale": None}},
            {"name": "joint_pos_rel", "shape": [6], "overloads": {"history_length": 0, "scale": None}},
            {"name": "height_scan", "shape": [4], "overloads": {}}]  # fmt: skip
    robot = {"joint_names": JOINTS[::-1], "default_joint_pos": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
             "default_joint_stiffness": [20.0] * 6, "default_joint_damping": [0.5] * 6}  # fmt: skip
    content = {
        "actions": [{"joint_names": JOINTS, "scale": 0.5, "offset": [0.1] * 6}], "articulations": {"robot": robot},
        "observations": {"policy": seen}, "scene": {"dt": 0.02},
    }  # fmt: skip
    (tmp_path / "IO_descriptors.yaml").write_text(json.dumps(content))
    made = load_policy(onnx_policy(tmp_path / "isaac.onnx", 13, {}), tmp_path / "IO_descriptors.yaml")
    assert made.default.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1]
    assert made.terms[2].kind == "unknown"
    assert made.zero.tolist() == [0.1] * 6


def test_a_network_for_one_observation_is_run_for_many(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")

    weights = np.random.default_rng(0).normal(size=(27, 6)).astype(np.float32)
    file, seen = onnx_policy(tmp_path / "one.onnx", 27, META, weights, rows=1), np.eye(27)[:5]
    (at_once,) = open_session(file, with_any_batch(file)).run(None, {"obs": seen.astype(np.float32)})
    assert at_once == pytest.approx(weights[:5])
    assert load_policy(file).run(seen, None) == pytest.approx(weights[:5])

    model = onnx.load(str(file))  # an operator that holds the 1, too
    model.graph.node[0].output[0] = "product"
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([1, 6]), "shape"))
    model.graph.node.append(onnx.helper.make_node("Reshape", ["product", "shape"], ["actions"]))
    onnx.save(model, str(file))
    assert load_policy(file).run(seen, None) == pytest.approx(weights[:5])


def test_policies_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "noise.onnx").write_bytes(b"no network")
    with pytest.raises(GapError, match="not a readable ONNX"):
        load_policy(tmp_path / "noise.onnx")
    with pytest.raises(GapError, match="does not describe"):
        load_policy(onnx_policy(tmp_path / "bare.onnx", 27, {}))
    with pytest.raises(GapError, match="cannot be read"):
        load_policy(onnx_policy(tmp_path / "short.onnx", 27, {"joint_names": "a,b"}))
    with pytest.raises(GapError, match="cannot be read"):
        load_policy(onnx_policy(tmp_path / "alpha.onnx", 27, META | {"action_alpha": "0"}))
    for text, match in (
        ("a: " + "[" * 600, "YAML"), ("a: &a [1]\nb: *a\n", "YAML"), ("3", "no map"), ("x: 1\n", "no contract"),
    ):  # fmt: skip
        (tmp_path / "deploy.yaml").write_text(text)
        with pytest.raises(RealsimError, match=match):
            load_policy(tmp_path / "bare.onnx", tmp_path / "deploy.yaml", JOINTS)
    (tmp_path / "deploy.yaml").write_text("joint_ids_map: [9]\n")
    with pytest.raises(GapError, match="cannot be read"):
        load_policy(tmp_path / "bare.onnx", tmp_path / "deploy.yaml", JOINTS)


def test_weights_lie_beside_the_policy_wherever_it_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    onnx = pytest.importorskip("onnx", reason="onnx is not installed: pip install -e '.[dev]'")
    meta = META | {"observation_names": "joint_pos"}
    home, away = tmp_path / "home", tmp_path / "away"
    home.mkdir()
    away.mkdir()
    model = onnx.load(str(onnx_policy(tmp_path / "whole.onnx", 6, meta)))
    onnx.save(model, str(home / "p.onnx"), save_as_external_data=True, location="w.data", size_threshold=0)
    monkeypatch.chdir(away)
    assert load_policy(home / "p.onnx").run(np.ones((1, 6)), None).tolist() == [[6.0] * 6]
    (away / "w.data").write_bytes((home / "w.data").read_bytes())
    (home / "w.data").unlink()
    with pytest.raises(GapError, match="absent"):
        load_policy(home / "p.onnx")
    outside = (home / "p.onnx").read_bytes().replace(b"w.data", b"../w.d")
    (home / "p.onnx").write_bytes(outside)
    with pytest.raises(RealsimError, match=r"leads out|not a readable"):
        load_policy(home / "p.onnx")
