"""Contract errors: a policy deployed wrongly on a simulated quadruped, and what `check` says.

    python benchmarks/diagnosis/contract.py --jobs 2 --out benchmarks/results/gap_contract.json

Three kinds of policies: the one that ships, with a camera and a history of eight (`realsim`); one of one moment with
mjlab's metadata (`mjlab`); one of four moments with scales, by deploy.yaml of unitree_rl_lab (`unitree`). The latter
two are random networks (each seed another) whose robot stands and sways: a network that does nothing useful replays as
well as one that walks, and fails the check as well.

Every log comes from `trainer.deploy.loop.deploy` on `MujocoRobot`. The mistake is made in the robot's readings and
targets, in the metadata that the loop believes, or between the loop and the network; nothing of it is shared with
`realsim.gap.checks.contract.loop`. Sensors of the log have noise that the policy did not see. Seeds below 100 were used
to set the thresholds; withheld seeds start at 1000.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store
from realsim.gap.checks.contract import Steps, check, load_policy
from realsim.gap.checks.contract.steps import Run
from trainer import terrain as terrains
from trainer.deploy.loop import DeployConfig, deploy
from trainer.deploy.mujoco import MujocoRobot
from trainer.deploy.robot import Reading
from trainer.policies import base_of
from trainer.ppo import export
from trainer.robots import named
from trainer.tasks import ObservationLayout

SECONDS, RUNS, LEAST = 4.0, 2, 80
NOISE = {"pos": 5e-4, "vel": 0.02, "gyro": 0.01, "quat": 5e-4, "torque": 0.05}
POLICIES = {"realsim": 8, "mjlab": 1, "unitree": 4}
"""Kind of policy -> moments of its history."""
WIDTHS = {"base_ang_vel": 3, "gravity": 3, "steering_command": 3, "joint_pos": 12, "joint_vel": 12, "last_action": 12}
SCALES = {"base_ang_vel": 0.2, "gravity": 1.0, "steering_command": 1.0, "joint_pos": 1.0, "joint_vel": 0.05,
          "last_action": 1.0}  # fmt: skip
"""Of `unitree`."""
MOST_TRIES = 20


def unchanged(values: np.ndarray) -> np.ndarray:
    return values


@dataclass
class Wrong:
    """Where a mistake is made."""

    see: Callable[[Reading, np.ndarray], Reading] = lambda reading, quat: reading
    send: Callable[[np.ndarray], np.ndarray] = unchanged
    facts: Callable[[export.Deployment], export.Deployment] = lambda facts: facts
    vector: Callable[[np.ndarray], np.ndarray] = unchanged
    steer: Callable[[np.ndarray], np.ndarray] = lambda told: told
    gains: np.ndarray = field(default_factory=lambda: np.ones(12))
    faster: int = 1
    """Times as often as it was trained at that the policy is asked; the robot is simulated at the trained rate."""
    every: int = 1
    """Simulated policy steps for which one target is held."""
    late: dict[str, int] = field(default_factory=dict)
    """Field of a reading -> policy steps by which it is old."""
    stale: Callable[[int], bool] = lambda step: False
    """Whether a step's reading is the one before."""
    shows: bool = False
    """Whether `send` or `vector` changed anything so far. A command that is never given cannot be seen turned: such a
    draw is no case."""


@dataclass
class Logged:
    """What the robot's drivers write down."""

    rows: list[dict[str, np.ndarray]] = field(default_factory=list)


class LoggedRobot(MujocoRobot):
    """The simulated robot behind a wrong interface; logs what really was read and sent, in the robot's own terms."""

    def __init__(self, robot: Any, wrong: Wrong, rng: np.random.Generator, camera: bool) -> None:
        super().__init__(robot, terrains.flat(), depth=camera)
        self.wrong, self.rng, self.log, self.past = wrong, rng, Logged(), []
        self.told = np.zeros(3)

    def start(self, kp: np.ndarray, kd: np.ndarray) -> None:
        self.stopped = False

    def read(self) -> Reading:
        reading = super().read()
        quat = self.physics.state.base_quat[0].double().numpy()
        self.past.append(self.wrong.see(reading, quat))
        newest = len(self.past) - 1 - self.wrong.stale(len(self.past))
        fields = ("ang_vel", "gravity", "joint_pos", "joint_vel")
        ages = {k: self.wrong.late.get(k, self.wrong.late.get("", 0)) for k in fields}
        late = replace(reading, **{k: getattr(self.past[max(newest - a, 0)], k) for k, a in ages.items()})
        self.now = (reading, quat)
        # The loop gives up on a robot that looks upside down, which a misread one does at once: here it goes on.
        return replace(late, gravity=late.gravity * (1 - 1e-5))

    def write(self, targets: np.ndarray) -> None:
        sent = self.wrong.send(targets)
        self.wrong.shows |= self.wrong.send is not unchanged and bool((sent != targets).any())
        for repeat in range(self.wrong.every):
            state = self.physics.state
            reading, quat = (MujocoRobot.read(self), state.base_quat[0].double().numpy()) if repeat else self.now
            row = {"command": sent, "pos": reading.joint_pos, "vel": reading.joint_vel, "gyro": reading.ang_vel,
                   "quat": quat, "told": self.told, "torque": state.joint_torque[0].double().numpy()}  # fmt: skip
            noisy = {k: np.array(v) + (self.rng.normal(0, NOISE[k], np.shape(v)) if k in NOISE else 0)
                     for k, v in row.items()}  # fmt: skip
            self.log.rows.append(noisy | ({} if reading.depth is None else {"frames": reading.depth}))
            super().write(sent)


class WrongSession:
    """The network behind inputs that were put together wrongly."""

    def __init__(self, session: Any, wrong: Wrong, scale: np.ndarray | float) -> None:
        self.session, self.wrong, self.scale = session, wrong, scale

    def run(self, names: Any, inputs: dict[str, np.ndarray]) -> Any:
        right = inputs["vector"] * self.scale
        vector = self.wrong.vector(right)
        self.wrong.shows |= self.wrong.vector is not unchanged and bool((vector != right).any())
        return self.session.run(names, inputs | {"vector": vector.astype(np.float32)})


# ---------------------------------------------------------------- the policy


def write_policy(folder: Path, policy: str, seed: int) -> tuple[Path, Path | None, export.Deployment]:
    """(policy.onnx, deploy.yaml or None, what the loop believes). See `write_random`."""
    if policy == "realsim":
        path = base_of("quadruped").with_suffix(".onnx")
        return path, None, export.load(path)[1]
    path = folder / "policy.onnx"
    facts = write_random(path, seed, POLICIES[policy], SCALES if policy == "unitree" else dict.fromkeys(WIDTHS, 1.0))
    if policy == "unitree":
        action = {"scale": list(facts.action_scale), "offset": list(facts.default), "clip": None}
        terms = {k: {"scale": [SCALES[k]] * w, "history_length": POLICIES[policy]} for k, w in WIDTHS.items()}
        content = {
            "joint_ids_map": list(range(12)), "step_dt": facts.policy_dt, "stiffness": list(facts.kp),
            "damping": list(facts.kd), "default_joint_pos": list(facts.default),
            "actions": {"JointPositionAction": action}, "observations": terms,
        }  # fmt: skip
        (folder / "deploy.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
        return path, folder / "deploy.yaml", facts
    import onnx

    model = onnx.load(str(path))
    del model.metadata_props[:]
    numbers = {"default_joint_pos": facts.default, "action_scale": facts.action_scale, "joint_stiffness": facts.kp,
               "joint_damping": facts.kd}  # fmt: skip
    texts = {k: ",".join(f"{x:.3f}" for x in v) for k, v in numbers.items()}
    texts |= {"joint_names": ",".join(facts.layout.actions), "observation_names": ",".join(WIDTHS)}
    for key, value in texts.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.save(model, str(folder / "mjlab.onnx"))
    return folder / "mjlab.onnx", None, facts


def write_random(path: Path, seed: int, history: int, scales: dict[str, float]) -> export.Deployment:
    """A random network over some moments; each term moves the actions about as much as the others."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    robot = named("quadruped")
    rng = np.random.default_rng(seed)
    spread = {"base_ang_vel": 0.4, "gravity": 0.08, "steering_command": 0.5, "joint_pos": 0.15, "joint_vel": 1.5,
              "last_action": 0.6}  # fmt: skip
    share = {"base_ang_vel": 0.6, "gravity": 0.5, "steering_command": 1.0, "joint_pos": 0.6, "joint_vel": 0.5,
             "last_action": 0.4}  # fmt: skip
    actor = tuple((name, history * width) for name, width in WIDTHS.items())
    layout = ObservationLayout(actor, actor, None, tuple(robot.joints))
    columns, level = [], []
    for name, width in WIDTHS.items():
        fade = np.repeat(rng.uniform(0.3, 1.0, history), width)
        columns.append(share[name] * fade / spread[name] / scales[name] / np.sqrt(history * width))
        # Gravity points down when nothing tilts.
        level.append(np.tile([0.0, 0.0, -1.0], history) if name == "gravity" else np.zeros(history * width))
    w1 = rng.normal(size=(layout.actor_width, 64)) * np.concatenate(columns)[:, None]
    w2 = rng.normal(size=(64, 12)) / np.sqrt(64) * rng.uniform(0.8, 1.6)
    tensors = {"level": np.concatenate(level), "w1": w1, "b1": rng.normal(0, 0.2, 64), "w2": w2}
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
        tuple(robot.kp.tolist()), tuple(robot.kd.tolist()),
    )  # fmt: skip
    entry = model.metadata_props.add()
    entry.key, entry.value = export.KEY, json.dumps({"version": export.VERSION, **asdict(facts)})
    onnx.save(model, str(path))
    return facts


# ---------------------------------------------------------------- the mistakes


def split(vector: np.ndarray, history: int) -> list[np.ndarray]:
    """Terms (history, width) of an observation (1, A)."""
    ends = np.cumsum([history * w for w in WIDTHS.values()])[:-1]
    return [p.reshape(history, w) for p, w in zip(np.split(vector[0], ends), WIDTHS.values(), strict=True)]


def blocks(change: Callable[[np.ndarray], np.ndarray], history: int) -> Callable[[np.ndarray], np.ndarray]:
    """A change of every term's history (history, width)."""
    return lambda vector: np.concatenate([change(p).ravel() for p in split(vector, history)])[None]


class Strided:
    """Histories whose moments are two steps apart."""

    def __init__(self, history: int) -> None:
        self.history = history
        self.past: list[list[np.ndarray]] = []

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        self.past.append([p[-1] for p in split(vector, self.history)])
        at = [max(len(self.past) - 1 - 2 * back, 0) for back in range(self.history)][::-1]
        terms = [np.stack([self.past[k][i] for k in at]) for i in range(len(WIDTHS))]
        return np.concatenate([t.ravel() for t in terms])[None]


class LowPass:
    """Targets of which each keeps a part of the one before."""

    def __init__(self, alpha: float) -> None:
        self.alpha = alpha
        self.last: np.ndarray | None = None

    def __call__(self, targets: np.ndarray) -> np.ndarray:
        self.last = targets if self.last is None else self.alpha * targets + (1 - self.alpha) * self.last
        return self.last


def rotate(quat: np.ndarray, v: np.ndarray) -> np.ndarray:
    w, u = quat[0], quat[1:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def mistakes(kind: str, rng: np.random.Generator, history: int) -> Wrong:
    """One mistake of a kind, drawn."""
    robot = named("quadruped")
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
    which = int(rng.integers(3))

    def seen(**change: Callable[[Reading, np.ndarray], np.ndarray]) -> Callable[[Reading, np.ndarray], Reading]:
        return lambda r, q: replace(r, **{k: f(r, q) for k, f in change.items()})

    if kind == "joint_order":
        if which == 0:
            return Wrong(send=lambda t: t[order])
        if which == 1:  # velocities alone
            return Wrong(see=seen(joint_vel=lambda r, q: r.joint_vel[order]))
        return Wrong(see=seen(joint_pos=lambda r, q: r.joint_pos[order], joint_vel=lambda r, q: r.joint_vel[order]),
                     send=lambda t: t[back])  # fmt: skip
    if kind == "joint_sign":
        if rng.random() < 0.5:
            return Wrong(send=lambda t: robot.default + signs * (t - robot.default))
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
        gain = float(rng.choice([0.5, 0.8, 1.4, 2.0])) * np.ones(12)
        if which == 0:  # of one joint
            gain = np.where(signs < 0, 0.64, 1.0)
        return Wrong(facts=lambda f: replace(f, action_scale=tuple(gain * np.asarray(f.action_scale))))
    if kind == "gains":
        ratio = float(rng.choice([0.5, 0.8, 1.25, 2.0]))
        return Wrong(gains=np.where(signs < 0, ratio, 1.0) if which == 0 else np.full(12, ratio))
    if kind == "quaternion_order":
        return Wrong(see=seen(gravity=lambda r, q: rotate(q[[3, 0, 1, 2]] * [1, -1, -1, -1], down)))
    if kind == "gravity_frame":
        if rng.random() < 0.5:
            return Wrong(see=seen(gravity=lambda r, q: -r.gravity))
        return Wrong(see=seen(gravity=lambda r, q: rotate(q, down)))
    if kind == "rate_frame":
        if rng.random() < 0.5:
            return Wrong(see=seen(ang_vel=lambda r, q: r.ang_vel[[1, 0, 2]] * [1, -1, 1]))
        return Wrong(see=seen(ang_vel=lambda r, q: -r.ang_vel))
    if kind == "imu_rotation":
        half = 0.5 * rng.uniform(0.12, 0.5)
        axis = rng.normal(size=3)
        quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
        both = {"gravity": lambda r, q: rotate(quat, r.gravity)}
        if which:
            both |= {"ang_vel": lambda r, q: rotate(quat, r.ang_vel)}
        return Wrong(see=seen(**both))
    if kind == "control_period":
        return Wrong(every=int(rng.choice([2, 3])))
    if kind == "history_order":
        if rng.random() < 0.5:
            return Wrong(vector=blocks(lambda p: p[::-1], history))
        return Wrong(vector=lambda v: np.concatenate(split(v, history), axis=1).ravel()[None])
    if kind == "history_length":
        held = int(rng.integers(1, history))
        keep = history - 1 - np.minimum(np.arange(history)[::-1], held - 1)
        return Wrong(vector=blocks(lambda p: p[keep], history))
    if kind == "history_stride":
        return Wrong(vector=Strided(history))
    if kind == "sensor_delay":
        return Wrong(late={"": int(rng.integers(1, 4))})
    if kind == "sensor_age":
        late = int(rng.integers(1, 4))
        return Wrong(late=dict.fromkeys(("ang_vel", "gravity") if which else ("joint_pos", "joint_vel"), late))
    if kind == "irregular_readings":
        return Wrong(stale=lambda step: step % (3 + which) == 0)
    if kind == "clipped_action":
        limit = float(rng.choice([0.3, 0.5, 0.8]))
        return Wrong(facts=lambda f: replace(f, action_limit=limit))
    if kind == "clipped_target":
        return Wrong(send=lambda t: np.clip(t, robot.default - 0.06, robot.default + 0.06))
    if kind == "observation_scale":
        if which == 0:
            return Wrong(see=seen(joint_vel=lambda r, q: 0.05 * r.joint_vel))
        factor = 0.25 if which == 1 else 57.29578
        return Wrong(see=seen(ang_vel=lambda r, q: factor * r.ang_vel))
    if kind == "observation_offset":
        bias = rng.choice([-1, 1], 3) * rng.uniform(0.2, 0.5, 3)
        return Wrong(see=seen(ang_vel=lambda r, q: r.ang_vel + bias))
    if kind == "velocity_command":
        turned = np.zeros(3) if which == 0 else np.array([1.0, -1.0, -1.0]) if which == 1 else -np.ones(3)
        at = 6 * history
        return Wrong(vector=lambda v: np.concatenate(
            [v[:, :at], v[:, at : at + 3 * history] * np.tile(turned, history), v[:, at + 3 * history :]], axis=1
        ))  # fmt: skip
    if kind == "last_action":
        at = history * 33
        scale = 0.0 if which == 0 else 0.25
        return Wrong(vector=lambda v: np.concatenate([v[:, :at], scale * v[:, at:]], axis=1))
    if kind == "term_order":
        i, j = [(0, 1), (3, 4), (4, 5)][which]

        def exchanged(vector: np.ndarray) -> np.ndarray:
            parts = [p.ravel() for p in split(vector, history)]
            parts[i], parts[j] = parts[j], parts[i]
            return np.concatenate(parts)[None]

        return Wrong(vector=exchanged)
    if kind == "action_filter":
        return Wrong(send=LowPass(float(rng.uniform(0.2, 0.8))))
    if kind == "scale_and_gains":
        return replace(mistakes("action_scale", rng, history), gains=np.full(12, 0.7))
    if kind == "imu_and_delay":
        return replace(mistakes("gravity_frame", rng, history), late={"": 2})
    return Wrong()


KINDS = (
    "joint_order", "joint_sign", "zero_offset", "default_pose", "action_scale", "gains", "quaternion_order",
    "gravity_frame", "rate_frame", "imu_rotation", "control_period", "history_order", "history_length",
    "history_stride", "sensor_delay", "sensor_age", "irregular_readings", "clipped_action", "clipped_target",
    "observation_scale", "observation_offset", "velocity_command", "last_action", "term_order", "scale_and_gains",
    "imu_and_delay", "action_filter",
)  # fmt: skip
NAMED = {k: {k} for k in KINDS} | {"scale_and_gains": {"action_scale", "gains"},
                                   "imu_and_delay": {"gravity_frame", "sensor_delay"}}  # fmt: skip
"""What must be named, and nothing else."""


def report(name: str) -> Wrong:
    """A public bug report, rebuilt from what it says."""
    turned = np.array([np.cos(0.06), 0.0, np.sin(0.06), 0.0])
    one = np.where(np.arange(12) == 4, 0.64, 1.0)
    by_kind = [0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11]

    def scaled(gain: np.ndarray | float) -> Callable[[export.Deployment], export.Deployment]:
        return lambda f: replace(f, action_scale=tuple(gain * np.asarray(f.action_scale)))

    return {
        "extreme-parkour 6": Wrong(faster=2),
        "rl_sar 58": Wrong(gains=np.full(12, 0.8)),
        "BFM-Zero 17": Wrong(facts=scaled(0.8), gains=np.full(12, 0.7)),
        "unitree_rl_mjlab 32": Wrong(facts=scaled(one)),
        "HOVER 29": Wrong(see=lambda r, q: replace(r, gravity=rotate(turned, r.gravity))),
        "TienKung-Lab 26": Wrong(see=lambda r, q: replace(r, joint_vel=r.joint_vel[by_kind])),
        "ros2_control 2529": Wrong(stale=lambda step: step % 4 == 0),
        "furuta 27": Wrong(late={"ang_vel": 2, "gravity": 2}),
        "IsaacLab 2447": Wrong(see=lambda r, q: replace(r, ang_vel=0.25 * r.ang_vel)),
    }[name]


REPORTS = {
    "extreme-parkour 6": {"control_period"}, "rl_sar 58": {"gains"}, "BFM-Zero 17": {"action_scale", "gains"},
    "unitree_rl_mjlab 32": {"action_scale"}, "HOVER 29": {"imu_rotation"}, "TienKung-Lab 26": {"joint_order"},
    "ros2_control 2529": {"irregular_readings"}, "furuta 27": {"sensor_age"}, "IsaacLab 2447": {"observation_scale"},
}  # fmt: skip
"""Reports of contract errors in public trackers (repository and number), with what must be named."""
NAMED |= REPORTS


def applies(kind: str, policy: str) -> bool:
    """Histories need some; the policy that ships is commanded straight ahead."""
    return not (kind.startswith("history") and POLICIES[policy] == 1)


def record(path: Path, policy: str, facts: export.Deployment, wrong: Wrong, seed: int) -> Steps:
    """Runs of a wrongly deployed policy as the log that its robot leaves."""
    rng = np.random.default_rng(seed)
    session = export.open_network(path)
    scale: np.ndarray | float = 1.0
    if policy == "unitree":
        scale = np.concatenate([np.full(w * POLICIES[policy], SCALES[k]) for k, w in WIDTHS.items()])
    base = named("quadruped")
    runs = []
    for number in range(RUNS):
        robot = LoggedRobot(base, wrong, rng, camera=policy == "realsim")
        model = robot.physics._terrain_model(0)  # the servos' own gains, whatever the loop believes
        model.actuator_gainprm[:, 0] *= wrong.gains
        model.actuator_biasprm[:, 1:3] *= wrong.gains[:, None]
        held = rng.uniform(-1, 1, (40, 3)) * [0.8, 0.5, 0.8]
        config = DeployConfig(seconds=SECONDS, realtime=False, max_tilt=math.pi, max_step=1e3,
                              speed=0.4 + 0.4 * number, ramp=2.0)  # fmt: skip

        def steer(_: float, robot: LoggedRobot = robot, held: np.ndarray = held) -> np.ndarray:
            robot.told = held[len(robot.past) // 15 % len(held)]
            return robot.told

        deploy(robot, WrongSession(session, wrong, scale), wrong.facts(facts), config, steer=steer)
        rows = robot.log.rows
        if len(rows) < LEAST:
            continue
        data = {k: np.array([r[k] for r in rows]) for k in rows[0]}
        if policy == "realsim":  # told straight ahead, faster over the first two seconds
            asked = 0.02 * (np.arange(len(rows)) // wrong.every)
            data["told"] = np.outer(config.speed * np.minimum(asked / config.ramp, 1.0), [1.0, 0.0, 0.0])
        # The torque that the servos give in a row is that of the row before, as a driver reports it.
        stamps = (0.02 * np.arange(len(rows)) + rng.normal(0, 2e-4, len(rows))) / wrong.faster
        moved = np.concatenate([[True], (np.abs(np.diff(data["command"], axis=0)) > 1e-9).any(axis=1)])
        quat = data["quat"] / np.linalg.norm(data["quat"], axis=1, keepdims=True)
        runs.append(Run(f"run{number}", np.sort(stamps), data["command"], data["pos"], data["vel"], data["gyro"], quat,
                        data["told"], moved, data["torque"], frames=data.get("frames")))  # fmt: skip
    if not runs or ((wrong.send is not unchanged or wrong.vector is not unchanged) and not wrong.shows):
        return Steps((), (), 0.02, 0.02)
    changes = float(np.median([np.median(np.diff(r.time[r.sent])) for r in runs]))
    return Steps(tuple(base.joints), tuple(runs), 0.02 / wrong.faster, changes)


def judge(policy: str, kind: str, seed: int) -> dict[str, Any] | None:
    """One row; None where the robot falls at once and leaves no log, or nothing of the mistake is in it."""
    with tempfile.TemporaryDirectory() as folder:
        path, deploy_yaml, facts = write_policy(Path(folder), policy, seed)
        loop_path = path if policy != "mjlab" else Path(folder) / "policy.onnx"
        rng = np.random.default_rng(seed)
        wrong = report(kind) if kind in REPORTS else mistakes(kind, rng, POLICIES[policy])
        steps = record(loop_path, policy, facts, wrong, seed)
        if not steps.runs:
            return None
        began = time.process_time()
        found = check(load_policy(path, deploy_yaml, facts.layout.actions), steps)
        seconds = time.process_time() - began
    named_ = [e["kind"] for e in found.errors]
    beside = [o["kind"] for e in found.errors for o in e["or"]]
    good = set(named_) == NAMED[kind] if kind else found.verdict == "kept"
    confident = found.verdict == "broken" or (found.verdict == "kept" and bool(kind))
    return {
        "policy": policy, "kind": kind, "seed": seed, "verdict": found.verdict, "named": named_, "beside": beside,
        "right": good and found.verdict != "unexplained", "wrong_and_sure": confident and not good, "left": found.left,
        "after": found.after, "sentence": found.sentence, "cpu_s": round(seconds, 1),
    }  # fmt: skip


def stood(task: tuple[str, str, int]) -> dict[str, Any]:
    """The row of the first of MOST_TRIES seeds that makes a case; see `judge`."""
    policy, kind, seed = task
    torch.set_num_threads(1)
    for tried in range(MOST_TRIES):
        if (row := judge(policy, kind, seed + tried)) is not None:
            return row
    raise SystemExit(f"{kind}: no policy stands")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--per-kind", type=int, default=1)
    parser.add_argument("--healthy", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--kinds", nargs="*", default=[*REPORTS, *KINDS])
    parser.add_argument("--policies", nargs="*", default=list(POLICIES))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    plan = [(p, k) for k in options.kinds for p in options.policies if applies(k, p) for _ in range(options.per_kind)]
    plan += [(options.policies[i % len(options.policies)], "") for i in range(options.healthy)]
    tasks = [(p, k, options.seed + MOST_TRIES * i) for i, (p, k) in enumerate(plan)]
    rows = []
    store = Store(options.out, ("policy", "kind", "seed")) if options.out else None
    if store:
        store.rows = []
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(stood, task) for task in tasks]):
            if done.exception():
                print(f"CRASHED: {done.exception()!r}", flush=True)
                continue
            rows.append(row := done.result())
            mark = "ok  " if row["right"] else "MISS" if row["kind"] else "FALSE"
            print(f"{mark} {row['policy']:8} {row['kind'] or 'healthy':18} seed {row['seed']} {row['cpu_s']} s "
                  f"{row['verdict']:11} {row['sentence']} {row['beside']}", flush=True)  # fmt: skip
            if store:
                store.facts = {"summary": summary(rows)}
                store.add(row)
    print(summary(rows))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    wrong = [r for r in rows if r["kind"]]
    return {
        "named": sum(r["right"] for r in wrong), "alone": sum(r["right"] and not r["beside"] for r in wrong),
        "of": len(wrong), "wrong_and_sure": sum(r["wrong_and_sure"] for r in wrong),
        "false_alarms": sum(r["verdict"] != "kept" for r in rows if not r["kind"]),
        "healthy": len(rows) - len(wrong),
        "median_cpu_s": float(np.median([r["cpu_s"] for r in rows])),
    }  # fmt: skip


if __name__ == "__main__":
    main()
