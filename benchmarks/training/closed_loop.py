"""Close the loop: a robot that fails where simulation succeeds, its logs, the cause, and a policy trained for it.

    python benchmarks/training/closed_loop.py --out loop                some 20 minutes of a core
    python benchmarks/training/closed_loop.py --out loop --minutes 20   stops; run it again to go on
    python benchmarks/training/closed_loop.py --out loop --course boxes:0.5:900 --iterations 200   on a GPU
    python benchmarks/training/closed_loop.py --out loop --robot g1 --course boxes:0.5:900 --iterations 200

The "real" robot is a simulated one with something that its model lacks, one thing at a time. The policy learnt
on the nominal model has to walk 4 m on flat ground in 10 s, or, with `--course`, the one that ships has to cross a
parkour course with its depth camera. Then, for each thing that is wrong:

1. The policy's success in simulation and on the robot.
2. The robot is logged while it stands and sways (the quadruped) or hangs by its pelvis and moves (G1): no walking is
   needed. It is diagnosed with all effects of the library, or with those of `--effects`, which takes less time.
3. The policy is fine-tuned with the diagnosis: patched, and randomised about what was found. Beside it, the same base,
   samples and seed with randomisation alone.
4. Both go back to the robot.

Every step keeps its result in loop/results.json, and is not done again; a robot of which all is done becomes a row of
benchmarks/results/close_the_gap.json.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np
import torch

import realsim as rs
from benchmarks.store import Store
from realsim import DiagnoseConfig
from realsim.core.files import to_json, write_text
from tests.truths.written import write_case
from trainer import terrain
from trainer.commands.common import find_terrain
from trainer.commands.task_file import load_task
from trainer.evaluate import EvaluationConfig, Setting, run, summarise, trial_env
from trainer.physics import PhysicsConfig
from trainer.physics.world import world_spec
from trainer.policies import TASKS, base_of
from trainer.ppo import checkpoint
from trainer.ppo.config import LoopConfig, NetworkConfig, PPOConfig, StrategyConfig
from trainer.ppo.distributed import pick_device
from trainer.robots import ROBOTS, TrainedRobot
from trainer.tasks.parkour import ParkourConfig
from trainer.tasks.parkour.config import (
    CommandConfig,
    DepthConfig,
    ObservationConfig,
    RandomisationConfig,
    TerminationConfig,
)
from trainer.tasks.parkour.terminations import SUCCESS
from trainer.trainers import Scene, TrainConfig, find

RESULTS = Path(__file__).parents[1] / "results" / "close_the_gap.json"
KEY = ("robot", "iterations", "effects_considered", "course")
FLAT = "flat"
ALONE = RandomisationConfig(push=0.0)
"""The trainer's own ranges: what is guessed where nothing is known."""
EXACT = RandomisationConfig(
    friction=(1, 1), mass=(1, 1), payload=(0, 0), com=(0, 0), kp=(1, 1), kd=(1, 1), armature=(1, 1),
    joint_friction=(0, 0), delay=(0, 0), encoder=0.0, gyro=0.0, push=0.0,
)  # fmt: skip
"""A robot that is exactly its model."""


@dataclass(frozen=True)
class Walk:
    """Where the robot has to go, and who can teach it."""

    name: str
    """`flat`, or a course as `realsim finetune` takes it."""
    worlds: int = 0
    robot: str = "quadruped"

    @property
    def flat(self) -> bool:
        return self.name == FLAT

    @cached_property
    def terrain(self) -> terrain.Terrain:
        return terrain.flat() if self.flat else find_terrain(self.name)[0]

    @cached_property
    def device(self) -> torch.device:
        """Small networks on flat ground need no GPU."""
        return torch.device("cpu") if self.flat else pick_device("auto")

    @property
    def engine(self) -> str:
        return "warp" if self.device.type == "cuda" else "mujoco"

    def task(self, random: RandomisationConfig) -> ParkourConfig:
        """Flat ground needs no camera; the robot is told where the goal lies, as by somebody with a joystick."""
        if not self.flat:
            return replace(load_task(TASKS[self.robot]), randomisation=random)
        return ParkourConfig(
            command=CommandConfig(speed=(0.6, 0.6)),
            observation=ObservationConfig(steered=True),
            depth=DepthConfig(use=False),
            termination=TerminationConfig(seconds=10.0),
            randomisation=random,
        )

    def training(self, iterations: int, random: RandomisationConfig, **more: Any) -> TrainConfig:
        """One core and small networks (those of benchmarks/training/trainer_cpu.py) on flat ground, `realsim
        finetune`'s values on a course."""
        loop = LoopConfig(iterations=iterations, checkpoint_every=25, evaluate_every=0, tensorboard=False)
        if not self.flat:
            return TrainConfig(
                robot=self.robot, worlds=self.worlds, device=str(self.device), task=self.task(random), loop=loop,
                ppo=PPOConfig(std_limits=(1.0, 0.3)), tuning=StrategyConfig(start_std=0.3), **more,
            )  # fmt: skip
        return TrainConfig(
            robot="quadruped",
            worlds=self.worlds or 128,
            engine="mujoco",
            device="cpu",
            threads=1,
            task=self.task(random),
            loop=loop,
            ppo=PPOConfig(
                networks=NetworkConfig(actor=(128, 64), critic=(128, 64), std=0.6),
                epochs=4,
                minibatches=2,
                entropy_weight=0.0,
                desired_kl=0.015,
                learning_rates=(1e-4, 3e-3),
            ),
            **more,
        )


@dataclass(frozen=True)
class Real:
    """What the robot has and its model lacks."""

    what: str
    change: Callable[[Any], None] = lambda spec: None
    """Changes a `mujoco.MjSpec` of the robot."""
    delay: float = 0.0
    """Seconds by which commands come late."""

    def robot(self, name: str) -> TrainedRobot:
        nominal = ROBOTS[name]()
        spec = nominal.robot.spec.copy()
        self.change(spec)
        return replace(nominal, robot=replace(nominal.robot, spec=spec))


def _load(body: str, mass: float, place: tuple[float, float, float]) -> Callable[[Any], None]:
    def change(spec: Any) -> None:
        box = spec.body(body).add_body(name="load", pos=place)
        box.mass, box.inertia, box.explicitinertial = mass, [0.002 * mass] * 3, True

    return change


def _weak(spec: Any) -> None:
    for motor in spec.actuators:
        motor.gainprm, motor.biasprm = 0.65 * motor.gainprm, 0.65 * motor.biasprm
        motor.forcerange = 0.65 * motor.forcerange


REAL = {
    "quadruped": {
        "payload": Real("carries 3 kg at the back and left of its trunk", _load("trunk", 3.0, (-0.10, 0.04, 0.08))),
        "motors": Real("has motors of 65 % of their torque", _weak),
        "delay": Real("gets its commands 50 ms late", delay=0.05),
    },
    "g1": {  # no load: its waist hardly holds the trunk, 3 kg cost the base nothing, and 6 kg fold it to its stop
        "motors": Real("has motors of 65 % of their torque", _weak),
        "delay": Real("gets its commands 50 ms late", delay=0.05),
    },
}


# ---------------------------------------------------------------- 1. success


def success(policy: Path, walk: Walk, real: Real | None, trials: int) -> dict[str, Any]:
    """Trials of a policy on a robot; None is the robot that its model describes.

    `rate` of the trials that arrive in time with its `interval`; `speed` in m/s towards the goal, which still tells
    policies apart where all of them arrive: a trial that fails has taken all of its time.
    """
    real = real or Real("is its model")
    random = replace(EXACT, delay=(real.delay, real.delay))
    physics = PhysicsConfig(threads=1, device=str(walk.device))
    setting = Setting(real.robot(walk.robot), walk.engine, None, walk.task(random), physics)
    config = EvaluationConfig(trials=trials, worlds=min(trials, 100))
    env = trial_env(walk.terrain, config.worlds, config, setting)
    found = run(checkpoint.load(policy)[0].to(walk.device).act, env, trials)
    last = summarise(walk.terrain, "trained", found, env, config)
    time_taken = torch.where(found.outcome == SUCCESS, found.seconds, setting.task.termination.seconds)
    way = float(np.linalg.norm((walk.terrain.goal.centre - walk.terrain.start.centre)[:2]))
    return {
        "what": real.what,
        "rate": last.rate,
        "interval": last.interval,
        "speed": float((way * found.covered / time_taken).mean()),
        "trials": trials,
        "reasons": last.reasons,
        "covered": last.covered,
        "seconds": last.seconds,
    }


# ---------------------------------------------------------------- 2. logs and diagnosis

RUNS, SECONDS, RATE = 4, 3.0, 100
NOISE = {"joint_pos": 3e-4, "joint_vel": 0.01, "joint_torque": 0.1, "base_pos": 3e-4}


def write_log(real: Real, name: str, folder: Path) -> None:
    """Runs of the robot and the model that is believed in, as `realsim diagnose` reads them."""
    nominal = ROBOTS[name]()
    believed = _stand(nominal)
    believed.compile()
    model, names = _stand(real.robot(name)).compile(), list(nominal.joints)
    runs = {f"run_{k}": record(model, nominal, real.delay, np.random.default_rng(k)) for k in range(RUNS)}
    write_case(folder, believed.to_xml(), runs, joint_names=names, actuator_names=names, torque_kind="measured")


def _stand(robot: TrainedRobot) -> Any:
    """Where the robot is logged: a quadruped on the floor, one with arms hung up by its pelvis."""
    spec = world_spec(robot, terrain.flat(), 0, PhysicsConfig())
    if robot.upper_body:
        for joint in [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
            spec.delete(joint)
        spec.body(robot.base).pos = [0, 0, 1.5]
    return spec


def record(model: Any, robot: TrainedRobot, delay: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """One run: the robot rests on its servos, then moves."""
    data, dt = mujoco.MjData(model), model.opt.timestep
    base = model.nq - model.nu  # numbers of the free joint, or none
    if base:
        data.qpos[:7] = [0, 0, robot.standing_height, 1, 0, 0, 0]
    data.qpos[base:] = data.ctrl[:] = robot.default
    mujoco.mj_step(model, data, round((2.0 if base else 8.0) / dt))  # it has sagged into its servos; arms swing longer
    data.time = 0.0
    every, late = round(1 / RATE / dt), round(delay / dt)
    sent, move = [robot.default] * (late + 1), _sway(rng) if base else _wave(robot, rng)
    signals = {"joint_pos": data.qpos[base:], "joint_vel": data.qvel[-model.nu :], "joint_torque": data.actuator_force}
    log: dict[str, list[np.ndarray]] = {n: [] for n in ("time", "command", *signals)}
    if base:
        signals["base_pos"] = data.qpos[:3]
        log |= {"base_pos": [], "base_quat": []}
    start = data.qpos.copy()
    for k in range(round(SECONDS / dt)):
        if k % every == 0:
            ramp = np.clip((data.time - 0.4) / 0.5, 0, 1)
            command = robot.default + ramp * move(data.time)
            for name, value in signals.items():
                log[name].append(value + rng.normal(0, NOISE[name], len(value)))
            log["time"].append(np.array(data.time))
            log["command"].append(command)
            if base:
                log["base_quat"].append(data.qpos[3:7].copy())
        sent = [*sent[1:], command]
        data.ctrl[:] = sent[0]
        mujoco.mj_step(model, data)
    return {name: np.array(values) for name, values in log.items()} | {"init_qpos": start}


Motion = Callable[[float], np.ndarray]
"""Radians of each joint from the default pose at a time in seconds."""


def _sway(rng: np.random.Generator) -> Motion:
    """A quadruped crouches, pitches and rolls, at another rate in each run."""
    rates, phases = rng.uniform(0.3, 1.0, 3), rng.uniform(0, 6, 3)
    legs = np.array([[x, y] for x in (1, -1) for y in (1, -1)])  # FL, FR, RL, RR

    def move(t: float) -> np.ndarray:
        crouch, pitch, roll = np.array([0.09, 0.05, 0.04]) * np.sin(2 * np.pi * rates * t + phases)
        bend = crouch + pitch * legs[:, 0]
        return np.stack([roll + 0 * bend, bend, -2 * bend], axis=1).ravel()

    return move


def _wave(robot: TrainedRobot, rng: np.random.Generator) -> Motion:
    """A robot that hangs moves all its joints, each at its own rate."""
    rates, phases = rng.uniform(0.3, 1.2, len(robot.joints)), rng.uniform(0, 6, len(robot.joints))
    room = np.minimum(robot.upper - robot.default, robot.default - robot.lower)
    return lambda t: np.minimum(0.2, 0.7 * room) * np.sin(2 * np.pi * rates * t + phases)


# ---------------------------------------------------------------- 3. training


def train(out: Path, walk: Walk, iterations: int, left: Callable[[], float], random: RandomisationConfig,
          base: Path | None, diagnosis: Path | None = None) -> bool:  # fmt: skip
    """Go on until this many iterations have been done in all; False where the time was over before."""
    last = out / "policy.pt"
    done = checkpoint.read(last)["training"]["iteration"] if last.is_file() else 0
    if done >= iterations:
        return True
    config = walk.training(iterations, random, diagnosis=diagnosis, resume=last if done else None)
    config = replace(config, loop=replace(config.loop, minutes=max(0.1, left())))
    if base is not None and config.resume is None:
        config = replace(config, strategy="full")
    result = find("ppo")(Scene((walk.terrain,)), base if config.resume is None else None, config, out)
    return result.iterations >= iterations


# ---------------------------------------------------------------- the loop


class Loop:
    """The steps in order; each leaves its result in the folder, and the time may be over before any of them."""

    def __init__(self, out: Path, args: argparse.Namespace) -> None:
        self.out, self.args, self.began = out, args, time.monotonic()
        self.file = out / "results.json"
        self.results: dict[str, Any] = json.loads(self.file.read_text()) if self.file.is_file() else {}

    def left(self) -> float:
        """Minutes."""
        return float(self.args.minutes - (time.monotonic() - self.began) / 60)

    def step(self, key: str, what: str, work: Callable[[], Any]) -> Any:
        """The result of a step, from before or now. Raises TimeoutError if it cannot begin in time."""
        if key not in self.results:
            if self.left() <= 0:
                raise TimeoutError
            print(f"[{(time.monotonic() - self.began) / 60:5.1f} min] {what}", flush=True)
            began = time.process_time()
            value = work()
            if value is False:
                raise TimeoutError
            self.results[key] = value if isinstance(value, dict) else {"done": True}
            self.results[key]["cpu_seconds"] = round(time.process_time() - began, 1)
            write_text(self.file, to_json(self.results))
        return self.results[key]

    def run(self) -> None:
        walk = Walk(self.args.course, self.args.worlds, self.args.robot)
        own = self.out / "base"
        shipped = own / "policy.pt" if walk.flat else base_of(walk.robot)
        base, trials, n = self.args.base or shipped, self.args.trials, self.args.iterations
        options = {"iterations": n, "trials": trials, "base": str(self.args.base or ""), "course": walk.name}
        options |= {} if walk.robot == "quadruped" else {"robot": walk.robot}
        if self.results.setdefault("options", options) != options:
            raise SystemExit(f"{self.out} was begun with {self.results['options']}: use those, or another folder")
        if self.args.base is None and walk.flat:
            self.step("base", "the base policy, on the nominal model",
                      lambda: train(own, walk, 400, self.left, replace(EXACT, use=False), None))  # fmt: skip
        self.step("nominal", "the base in simulation", lambda: success(base, walk, None, trials))
        for name in [k for k in REAL[walk.robot] if k in (self.args.wrong or [k])]:
            real, folder = REAL[walk.robot][name], self.out / name
            self.step(f"{name}/before", f"the base on the robot that {real.what}",
                      lambda r=real: success(base, walk, r, trials))  # fmt: skip
            self.step(
                f"{name}/diagnosis",
                "its logs, and the diagnosis",
                lambda r=real, f=folder: self.diagnosed(r, walk.robot, f),
            )
            for arm, diagnosis in (("patch", folder / "diagnosis"), ("random", None)):
                out = folder / arm
                self.step(f"{name}/{arm}/training", f"fine-tuning, {_ARMS[arm]}",
                          lambda o=out, d=diagnosis: train(o, walk, n, self.left, ALONE, base, d))  # fmt: skip
                self.step(f"{name}/{arm}", "that policy on the robot",
                          lambda o=out, r=real: success(o / "policy.pt", walk, r, trials))  # fmt: skip

    def diagnosed(self, real: Real, robot: str, folder: Path) -> dict[str, Any]:
        if not (folder / "case" / "log.json").is_file():
            write_log(real, robot, folder / "case")
        config = DiagnoseConfig(effects=tuple(self.args.effects), threads=1)
        found = rs.diagnose(folder / "case", folder / "diagnosis", config, overwrite=True)
        return {
            "effects_considered": list(config.effects),
            "verdict": str(found.verdict),
            "sentence": found.sentence,
            "causes": [str(c) for c in found.causes],
        }


_ARMS = {"patch": "patched by the diagnosis", "random": "with randomisation alone"}


# ---------------------------------------------------------------- rows


def rows(results: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each robot of which all is there."""
    found = []
    for name in dict.fromkeys(key.partition("/")[0] for key in results if "/" in key):
        parts = {k: results.get(f"{name}/{k}") for k in ("before", "diagnosis", "patch", "random")}
        if "nominal" not in results or None in parts.values():
            continue
        before, nominal, options = parts["before"], results["nominal"], results["options"]
        robot = " ".join([*[options[k] for k in ("robot",) if k in options], name])
        row: dict[str, Any] = {"robot": robot, "truth": before["what"], "iterations": options["iterations"]}
        row |= {"effects_considered": ", ".join(parts["diagnosis"].get("effects_considered") or ["all"])}
        row |= {"course": options["course"]}
        row |= {"verdict": parts["diagnosis"]["verdict"], "causes": parts["diagnosis"]["causes"]}
        row |= {"nominal": _short(nominal), "before": _short(before)}
        for arm in ("patch", "random"):
            row[arm] = _short(parts[arm])
            row[f"regained_{arm}"] = {what: _regained(nominal, before, parts[arm], what) for what in ("rate", "speed")}
        row["cpu_seconds"] = {k: v["cpu_seconds"] for k, v in results.items() if k.startswith(f"{name}/")}
        found.append(row)
    return found


def _regained(nominal: dict[str, Any], before: dict[str, Any], after: dict[str, Any], what: str) -> float | None:
    """Share of what was lost; None where nothing was."""
    lost = nominal[what] - before[what]
    return round((after[what] - before[what]) / lost, 3) if lost > 0 else None


def _short(trials: dict[str, Any]) -> dict[str, Any]:
    kept = {k: trials[k] for k in ("rate", "speed", "trials", "reasons", "seconds", "covered")}
    return kept | {"interval": [round(v, 4) for v in trials["interval"]]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("loop"))
    parser.add_argument("--minutes", type=float, default=1e6, help="stop at the next step after this time")
    parser.add_argument("--robot", choices=list(REAL), default="quadruped")
    parser.add_argument(
        "--wrong", nargs="+", choices=["payload", "motors", "delay"], help="with it; all that it may have, if not given"
    )
    parser.add_argument("--course", default=FLAT, help="FAMILY:DIFFICULTY:SEED, or the name of a test")
    parser.add_argument("--worlds", type=int, default=0, help="that train at once; 128 on flat ground")
    parser.add_argument("--iterations", type=int, default=100, help="of each fine-tuning")
    parser.add_argument("--trials", type=int, default=100, help="of each policy on each robot")
    parser.add_argument("--effects", nargs="*", default=[], help="that the diagnosis considers; all if not given")
    parser.add_argument("--base", type=Path, default=None, help="a policy of this task; one is trained if not given")
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    if args.robot != "quadruped" and args.course == FLAT:
        parser.error(f"--robot {args.robot} needs a --course: what ships for it crosses terrain, on a GPU")
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    loop = Loop(args.out, args)
    try:
        loop.run()
    except TimeoutError:
        print("the time is over; run it again to go on")
    store = Store(args.store, KEY)
    for row in rows(loop.results):
        print(json.dumps(store.add(row)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
