"""Withheld check of contract errors: a policy deployed wrongly on a simulated quadruped, and what `check` says.

    python benchmarks/diagnosis/contract.py --out benchmarks/results/gap_contract.json

Every log comes from `trainer.deploy.loop.deploy` on `MujocoRobot`. The mistake is made in the robot's readings and
targets, in the metadata that the loop believes, or between the loop and the network; nothing of it is shared with
`realsim.gap.checks.contract.replay`. Policies are random networks (each seed another) whose robot stands and sways: a
network that does nothing useful replays as well as one that walks, and fails the check as well. Sensors of the log
have noise that the policy did not see. Seeds below 100 were used to set the thresholds; withheld seeds start at 1000.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store
from realsim.gap.checks.contract import Steps, check, load_policy
from realsim.gap.checks.contract.steps import Run
from trainer import terrain as terrains
from trainer.deploy.loop import DeployConfig, deploy
from trainer.deploy.mujoco import MujocoRobot
from trainer.deploy.robot import Reading
from trainer.ppo import export
from trainer.robots import named
from trainer.tasks import ObservationLayout

SECONDS, RUNS, LEAST = 4.0, 3, 80
NOISE = {"pos": 5e-4, "vel": 0.02, "gyro": 0.01, "quat": 5e-4, "torque": 0.05}
HISTORY = 4
MOST_TRIES = 20


@dataclass
class Wrong:
    """Where a mistake is made."""

    see: Callable[[Reading, np.ndarray], Reading] = lambda reading, quat: reading
    send: Callable[[np.ndarray], np.ndarray] = lambda targets: targets
    facts: Callable[[export.Deployment], export.Deployment] = lambda facts: facts
    vector: Callable[[np.ndarray], np.ndarray] = lambda vector: vector
    steer: Callable[[np.ndarray], np.ndarray] = lambda told: told
    gains: float = 1.0
    every: int = 1
    """Simulated policy steps for which one target is held."""
    late: int = 0


@dataclass
class Logged:
    """What the robot's drivers write down."""

    rows: list[dict[str, np.ndarray]] = field(default_factory=list)


class LoggedRobot(MujocoRobot):
    """The simulated robot behind a wrong interface; logs what really was read and sent, in the robot's own terms."""

    def __init__(self, robot: Any, wrong: Wrong, rng: np.random.Generator) -> None:
        super().__init__(robot, terrains.flat(), depth=False)
        self.wrong, self.rng, self.log, self.past = wrong, rng, Logged(), []
        self.told = np.zeros(3)

    def start(self, kp: np.ndarray, kd: np.ndarray) -> None:
        self.stopped = False

    def read(self) -> Reading:
        reading = super().read()
        quat = self.physics.state.base_quat[0].double().numpy()
        self.past.append(self.wrong.see(reading, quat))
        late = self.past[max(len(self.past) - 1 - self.wrong.late, 0)]
        self.now = (reading, quat)
        # The loop gives up on a robot that looks upside down, which a misread one does at once: here it goes on.
        return replace(late, gravity=late.gravity * (1 - 1e-5))

    def write(self, targets: np.ndarray) -> None:
        sent = self.wrong.send(targets)
        for repeat in range(self.wrong.every):
            state = self.physics.state
            reading, quat = (MujocoRobot.read(self), state.base_quat[0].double().numpy()) if repeat else self.now
            row = {"command": sent, "pos": reading.joint_pos, "vel": reading.joint_vel, "gyro": reading.ang_vel,
                   "quat": quat, "told": self.told, "torque": state.joint_torque[0].double().numpy()}  # fmt: skip
            self.log.rows.append(
                {
                    k: np.array(v) + (self.rng.normal(0, NOISE[k], np.shape(v)) if k in NOISE else 0)
                    for k, v in row.items()
                }
            )
            super().write(sent)


class WrongSession:
    """The network behind inputs that were put together wrongly."""

    def __init__(self, session: Any, change: Callable[[np.ndarray], np.ndarray]) -> None:
        self.session, self.change = session, change

    def run(self, names: Any, inputs: dict[str, np.ndarray]) -> Any:
        return self.session.run(names, inputs | {"vector": self.change(inputs["vector"]).astype(np.float32)})


# ---------------------------------------------------------------- the policy


def write_policy(path: Path, seed: int) -> export.Deployment:
    """A random network over four moments; each term moves the actions about as much as the others."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    robot = named("quadruped")
    rng = np.random.default_rng(seed)
    widths = {
        "base_ang_vel": 3,
        "gravity": 3,
        "steering_command": 3,
        "joint_pos": 12,
        "joint_vel": 12,
        "last_action": 12,
    }
    spread = {
        "base_ang_vel": 0.4,
        "gravity": 0.08,
        "steering_command": 0.5,
        "joint_pos": 0.15,
        "joint_vel": 1.5,
        "last_action": 0.6,
    }
    share = {
        "base_ang_vel": 0.6,
        "gravity": 0.5,
        "steering_command": 1.0,
        "joint_pos": 0.6,
        "joint_vel": 0.5,
        "last_action": 0.4,
    }
    actor = tuple((name, HISTORY * width) for name, width in widths.items())
    layout = ObservationLayout(actor, actor, None, tuple(robot.joints))
    columns = []
    for name, width in widths.items():
        fade = np.repeat(rng.uniform(0.3, 1.0, HISTORY), width)
        columns.append(share[name] * fade / spread[name] / np.sqrt(HISTORY * width))
    w1 = rng.normal(size=(layout.actor_width, 64)) * np.concatenate(columns)[:, None]
    w2 = rng.normal(size=(64, 12)) / np.sqrt(64) * rng.uniform(0.8, 1.6)
    level = np.zeros(layout.actor_width)  # gravity points down when nothing tilts
    at = HISTORY * 3
    level[at : at + 3 * HISTORY] = np.tile([0.0, 0.0, -1.0], HISTORY)
    tensors = {"level": level, "w1": w1, "b1": rng.normal(0, 0.2, 64), "w2": w2}
    nodes = [
        helper.make_node("Sub", ["vector", "level"], ["x"]), helper.make_node("MatMul", ["x", "w1"], ["m1"]),
        helper.make_node("Add", ["m1", "b1"], ["a1"]), helper.make_node("Tanh", ["a1"], ["h1"]),
        helper.make_node("MatMul", ["h1", "w2"], ["action"]),
    ]  # fmt: skip
    graph = helper.make_graph(
        nodes, "policy", [helper.make_tensor_value_info("vector", TensorProto.FLOAT, ["n", layout.actor_width])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", 12])],
        [numpy_helper.from_array(v.astype(np.float32), k) for k, v in tensors.items()],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    facts = export.Deployment(
        layout, "quadruped", 0.02, tuple(robot.default.tolist()), tuple(robot.action_scale.tolist()),
        tuple(robot.kp.tolist()), tuple(robot.kd.tolist()), action_limit=10.0,
    )  # fmt: skip
    entry = model.metadata_props.add()
    entry.key, entry.value = export.KEY, json.dumps({"version": export.VERSION, **asdict(facts)})
    onnx.save(model, str(path))
    return facts


# ---------------------------------------------------------------- the mistakes


def blocks(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A change of every term's history (HISTORY, width)."""

    def apply(vector: np.ndarray) -> np.ndarray:
        out, at = [], 0
        for width in (3, 3, 3, 12, 12, 12):
            part = vector[0, at : at + HISTORY * width].reshape(HISTORY, width)
            out.append(change(part).ravel())
            at += HISTORY * width
        return np.concatenate(out)[None]

    return apply


def by_time(vector: np.ndarray) -> np.ndarray:
    parts, at = [], 0
    for width in (3, 3, 3, 12, 12, 12):
        parts.append(vector[0, at : at + HISTORY * width].reshape(HISTORY, width))
        at += HISTORY * width
    return np.concatenate(parts, axis=1).ravel()[None]


def rotate(quat: np.ndarray, v: np.ndarray) -> np.ndarray:
    w, u = quat[0], quat[1:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def mistakes(kind: str, rng: np.random.Generator) -> Wrong:
    """One mistake of a kind, drawn."""
    signs, offset = np.ones(12), np.zeros(12)
    joint = int(rng.integers(12))
    signs[joint] = -1
    offset[joint] = rng.choice([-1, 1]) * rng.uniform(0.08, 0.25)
    swapped = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]  # left and right legs
    by_kind = [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]
    order = list(rng.permutation([swapped, by_kind])[0])
    back = list(np.argsort(order))
    pose = rng.uniform(0.05, 0.2, 12) * rng.choice([-1, 1], 12)
    down = np.array([0.0, 0.0, -1.0])

    def seen(**change: Callable[[Reading, np.ndarray], np.ndarray]) -> Callable[[Reading, np.ndarray], Reading]:
        return lambda r, q: replace(r, **{k: f(r, q) for k, f in change.items()})

    if kind == "joint_order":
        if rng.random() < 0.5:
            return Wrong(send=lambda t: t[order])
        return Wrong(see=seen(joint_pos=lambda r, q: r.joint_pos[order], joint_vel=lambda r, q: r.joint_vel[order]),
                     send=lambda t: t[back])  # fmt: skip
    if kind == "joint_sign":
        if rng.random() < 0.5:
            default = named("quadruped").default
            return Wrong(send=lambda t: default + signs * (t - default))
        return Wrong(see=seen(joint_pos=lambda r, q: signs * r.joint_pos, joint_vel=lambda r, q: signs * r.joint_vel))
    if kind == "zero_offset":
        if rng.random() < 0.5:
            return Wrong(send=lambda t: t + offset)
        return Wrong(see=seen(joint_pos=lambda r, q: r.joint_pos + offset))
    if kind == "default_pose":
        if rng.random() < 0.5:
            return Wrong(send=lambda t: t + pose)
        return Wrong(facts=lambda f: replace(f, default=tuple(np.asarray(f.default) + pose)))
    if kind == "action_scale":
        gain = float(rng.choice([0.5, 0.8, 1.4, 2.0]))
        return Wrong(facts=lambda f: replace(f, action_scale=tuple(gain * np.asarray(f.action_scale))))
    if kind == "gains":
        return Wrong(gains=float(rng.choice([0.5, 0.75, 1.5, 2.0])))
    if kind == "quaternion_order":
        return Wrong(see=seen(gravity=lambda r, q: rotate(q[[3, 0, 1, 2]] * [1, -1, -1, -1], down)))
    if kind == "gravity_frame":
        if rng.random() < 0.5:
            return Wrong(see=seen(gravity=lambda r, q: -r.gravity))
        return Wrong(see=seen(gravity=lambda r, q: rotate(q, down)))
    if kind == "control_period":
        return Wrong(every=int(rng.choice([2, 3])))
    if kind == "history_order":
        return Wrong(vector=blocks(lambda p: p[::-1])) if rng.random() < 0.5 else Wrong(vector=by_time)
    if kind == "history_length":
        held = int(rng.integers(1, HISTORY))
        return Wrong(vector=blocks(lambda p: p[HISTORY - 1 - np.minimum(np.arange(HISTORY)[::-1], held - 1)]))
    if kind == "observation_delay":
        return Wrong(late=int(rng.integers(1, 4)))
    if kind == "clipped_action":
        limit = float(rng.choice([0.3, 0.5, 0.8]))
        return Wrong(facts=lambda f: replace(f, action_limit=limit))
    if kind == "observation_scale":
        if rng.random() < 0.5:
            return Wrong(see=seen(joint_vel=lambda r, q: 0.05 * r.joint_vel))
        return Wrong(see=seen(ang_vel=lambda r, q: np.degrees(r.ang_vel)))
    if kind == "velocity_command":
        return Wrong(steer=lambda t: 0 * t) if rng.random() < 0.5 else Wrong(steer=lambda t: t * [1, -1, -1])
    if kind == "last_action":
        at = HISTORY * 33
        return Wrong(vector=lambda v: np.concatenate([v[:, :at], 0 * v[:, at:]], axis=1))
    return Wrong()


KINDS = (
    "joint_order", "joint_sign", "zero_offset", "default_pose", "action_scale", "gains", "quaternion_order",
    "gravity_frame", "control_period", "history_order", "history_length", "observation_delay", "clipped_action",
    "observation_scale", "velocity_command", "last_action",
)  # fmt: skip


def record(policy: Path, facts: export.Deployment, wrong: Wrong, seed: int) -> Steps:
    """Runs of a wrongly deployed policy as the log that its robot leaves."""
    rng = np.random.default_rng(seed)
    session, _ = export.load(policy)
    base = named("quadruped")
    runs = []
    for number in range(RUNS):
        robot = LoggedRobot(base, wrong, rng)
        model = robot.physics._terrain_model(0)  # the servos' own gains, whatever the loop believes
        model.actuator_gainprm[:, 0] *= wrong.gains
        model.actuator_biasprm[:, 1:3] *= wrong.gains
        held = rng.uniform(-1, 1, (40, 3)) * [0.8, 0.5, 0.8]

        def steer(_: float, robot: LoggedRobot = robot, held: np.ndarray = held) -> np.ndarray:
            robot.told = held[len(robot.past) // 15 % len(held)]
            return wrong.steer(robot.told)

        deploy(robot, WrongSession(session, wrong.vector), wrong.facts(facts),
               DeployConfig(seconds=SECONDS, realtime=False, max_tilt=math.pi), steer=steer)  # fmt: skip
        rows = robot.log.rows
        if len(rows) < LEAST:
            continue
        data = {k: np.array([r[k] for r in rows]) for k in rows[0]}
        # The torque that the servos give in a row is that of the row before, as a driver reports it.
        time = 0.02 * np.arange(len(rows)) + rng.normal(0, 2e-4, len(rows))
        moved = np.concatenate([[True], (np.abs(np.diff(data["command"], axis=0)) > 1e-9).any(axis=1)])
        quat = data["quat"] / np.linalg.norm(data["quat"], axis=1, keepdims=True)
        runs.append(Run(f"run{number}", np.sort(time), data["command"], data["pos"], data["vel"], data["gyro"], quat,
                        data["told"], moved, data["torque"]))  # fmt: skip
    if not runs:
        return Steps((), (), 0.02, 0.02)
    changes = float(np.median([np.median(np.diff(r.time[r.sent])) for r in runs]))
    return Steps(tuple(base.joints), tuple(runs), 0.02, changes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--per-kind", type=int, default=3)
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    plan = [(k, i) for k in options.kinds for i in range(options.per_kind)] + [("", i) for i in range(options.healthy)]
    rows, seed = [], options.seed
    for kind, _ in plan:
        for _ in range(MOST_TRIES):  # a robot that falls at once leaves no log: another policy
            seed += 1
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "policy.onnx"
                facts = write_policy(path, seed)
                steps = record(path, facts, mistakes(kind, np.random.default_rng(seed)), seed)
                if not steps.runs:
                    print(f"{kind or 'healthy':18} seed {seed}: the robot falls, another policy", flush=True)
                    continue
                found = check(load_policy(path), steps)
            break
        else:
            raise SystemExit(f"{kind}: no policy stands")
        named_ = [e["kind"] for e in found.errors]
        rows.append({"kind": kind, "seed": seed, "verdict": found.verdict, "named": named_, "left": found.left,
                     "sentence": found.sentence, "steps": sum(len(r.time) for r in steps.runs)})  # fmt: skip
        good = named_[:1] == [kind] if kind else found.verdict == "kept"
        print(
            f"{'ok  ' if good else 'MISS'} {kind or 'healthy':18} seed {seed} {found.verdict:11} {found.sentence}",
            flush=True,
        )
    wrong_rows = [r for r in rows if r["kind"]]
    top = sum(r["named"][:1] == [r["kind"]] for r in wrong_rows)
    single = sum(r["named"] == [r["kind"]] for r in wrong_rows)
    alarms = sum(r["verdict"] != "kept" for r in rows if not r["kind"])
    misses = Counter(r["kind"] for r in wrong_rows if r["named"][:1] != [r["kind"]])
    print(
        f"top-1 {top} of {len(wrong_rows)}, alone {single}; "
        f"false alarms {alarms} of {len(rows) - len(wrong_rows)}; misses {dict(misses)}"
    )
    if options.out:
        summary = {
            "top1": top,
            "alone": single,
            "of": len(wrong_rows),
            "false_alarms": alarms,
            "healthy": len(rows) - len(wrong_rows),
        }
        store = Store(options.out, ("kind", "seed"))
        store.rows = []
        store.facts = {"summary": summary}
        for row in rows:
            store.add(row)


if __name__ == "__main__":
    main()
