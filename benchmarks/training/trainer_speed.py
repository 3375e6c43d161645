"""How fast training is, and where the time goes: physics, rays, rewards, inference, update.

    python benchmarks/training/trainer_speed.py  one GPU, G1, 4096 worlds x 24 steps, depth
    torchrun --nproc-per-node 2 benchmarks/training/trainer_speed.py                the same on each of two GPUs
    python benchmarks/training/trainer_speed.py --engine mujoco --worlds 128  the CPU engine, beside plain
    mujoco.rollout python benchmarks/training/trainer_speed.py --compare 4096 8192  the task as CUDA graphs and without
    them

An iteration is timed as it is trained, waiting for the device only at its end. Where the time goes is measured in more
iterations that wait after every part: their sum is more than the iteration took. Robots act at random, as an untrained
policy does, on the curriculum's 200 terrains, so that many lie on the ground: physics is at its slowest.
"""

from __future__ import annotations

import gc
import os
import platform
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import torch
import tyro

from benchmarks.store import Store
from trainer.physics import ENGINES, PhysicsConfig
from trainer.ppo import policy as policies
from trainer.ppo.config import PPOConfig
from trainer.ppo.distributed import Rank, all_sum, ranks
from trainer.ppo.runner import Runner
from trainer.rays import CASTERS
from trainer.robots import ROBOTS
from trainer.tasks.parkour import ParkourConfig, ParkourEnv, make
from trainer.tasks.parkour.config import DepthConfig
from trainer.tasks.parkour.depth import DepthCamera
from trainer.terrain import flat, grid

RESULTS = Path(__file__).parents[1] / "results" / "trainer_speed.json"
ROWS = 10
WARM = 6
"""Iterations before the clock starts where there may be graphs: by then those of the usual sizes are captured."""


@dataclass(frozen=True)
class Config:
    """What is timed."""

    engine: Literal["warp", "mujoco"] = "warp"
    """Physics engine."""
    robot: str = "g1"
    """A name of trainer.robots."""
    worlds: int = 4096
    """Worlds a process."""
    steps: int = 24
    """Policy steps an iteration."""
    depth: bool = True
    """Depth images in the observation (rays, image encoder)."""
    terrain: Literal["grid", "flat"] = "grid"
    """The curriculum's 200 terrains, or level ground."""
    iterations: int = 10
    """Iterations timed, after the first."""
    split: int = 3
    """Iterations in which every part is timed; 0 for none."""
    graphs: bool = True
    """On a GPU, the task around the physics as CUDA graphs."""
    compare: tuple[int, ...] = ()
    """Instead of one run: these numbers of worlds, each without and with graphs."""
    bfloat16: bool = False
    """Networks of the update in bfloat16."""
    physics_only: bool = False
    """Time engine and depth images alone, without task and learner."""
    contacts: int = PhysicsConfig.contacts_per_world
    """Room for contacts, a world on average (warp)."""
    constraints: int = PhysicsConfig.constraints_per_world
    """Room for constraint rows of a world (warp)."""
    broadphase: Literal["auto", "nxn", "sap"] = "auto"
    """How pairs of geoms are found (warp)."""
    jacobian: Literal["auto", "dense", "sparse"] = "auto"
    """How constraint Jacobians are stored."""
    newton: int = PhysicsConfig.iterations
    """Newton iterations at most."""
    self_collision: bool = False
    """Whether the robot's own limbs collide."""
    threads: int = 0
    """Threads of the CPU engine; 0 takes all cores."""
    device: str = "auto"
    """torch device."""
    out: Path = RESULTS
    """JSON file to which this run is added, under its label."""
    label: str = ""
    """Name of the run; made from the options if left out."""


class Stopwatch:
    """Seconds a part, each without those of the parts inside it."""

    def __init__(self, wait: Callable[[], None]) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._wait, self._open = wait, []

    def watch(self, owner: Any, method: str, part: str) -> None:
        """From now on `owner.method` is timed as that part (of this object only)."""
        function = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._wait()
            began = time.perf_counter()
            self._open.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                self._wait()
                whole = time.perf_counter() - began
                self.seconds[part] += whole - self._open.pop()
                if self._open:
                    self._open[-1] += whole

        setattr(owner, method, timed)


def main(config: Config) -> None:
    """Time it, print a table, add it to the JSON file."""
    torch.set_num_threads(
        config.threads or max(1, len(os.sched_getaffinity(0)) // int(os.environ.get("WORLD_SIZE", 1)))
    )
    with ranks("cpu" if config.engine == "mujoco" and config.device == "auto" else config.device) as rank:
        if config.compare:
            compare(config, rank)
            return
        result: dict[str, Any] = {"config": asdict(replace(config, out=Path())), "machine": machine(rank)}
        for name, section in (("engine", engine_alone), ("training", training)):
            if name == "training" and config.physics_only:
                continue
            try:
                result[name] = section(config, rank)
            except Exception as error:  # what was measured before is still worth having
                if rank.count > 1:
                    raise  # the other ranks would wait for this one
                result[name] = {"failed": f"{type(error).__name__}: {error}"}
            if rank.first:
                store(config, result, rank)
        if rank.first:
            print("\n".join(table(config, result, rank)))


def engine_alone(config: Config, rank: Rank) -> dict[str, float]:
    """Engine and depth images without a task: noisy targets, one world in fifty reset at every step."""
    robot, terrains = ROBOTS[config.robot](), courses(config)
    began = time.perf_counter()
    physics = ENGINES[config.engine](robot, terrains, config.worlds, settings(config, rank))
    wait(rank.device)
    built = time.perf_counter() - began
    device, worlds = rank.device, config.worlds
    rng = torch.Generator(device).manual_seed(0)
    default = torch.tensor(robot.default, dtype=torch.float32, device=device).repeat(worlds, 1)
    scale = torch.tensor(robot.action_scale, dtype=torch.float32, device=device)
    base = torch.tensor([0.0, 0.0, robot.standing_height], device=device)
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=device)

    caster = CASTERS["warp" if device.type == "cuda" else "embree"](terrains, str(device))
    camera = DepthCamera(robot.camera, DepthConfig(), caster, worlds, device) if robot.camera else None
    lands = torch.zeros(worlds, dtype=torch.long, device=device)

    def reset(ids: torch.Tensor) -> None:
        n = len(ids)
        lands[ids] = torch.randint(len(terrains), (n,), generator=rng, device=device)
        physics.reset(ids, base.repeat(n, 1), upright.repeat(n, 1), default[ids], lands[ids])

    def targets() -> torch.Tensor:
        return default + 0.5 * scale * torch.randn(default.shape, generator=rng, device=device)

    def policy_steps(count: int) -> tuple[float, float, float]:
        """Seconds of the engine, of depth images, and of plain `mujoco.rollout` from the same states and targets."""
        ours, images, plain = 0.0, 0.0, 0.0
        for step in range(count):
            reset(torch.nonzero(torch.arange(worlds, device=device) % 50 == step % 50)[:, 0])
            wanted = targets()
            if config.engine == "mujoco":
                plain += plain_rollout(physics, wanted)
            wait(device)
            began = time.perf_counter()
            physics.step(wanted)
            wait(device)
            stepped = time.perf_counter()
            if camera is not None:
                camera.render(physics.state, lands, None, rng)
                wait(device)
            ours += stepped - began
            images += time.perf_counter() - stepped
        return ours, images, plain

    everyone = torch.arange(worlds, device=device)
    for first in range(0, len(terrains), worlds):  # on the CPU a terrain is made ready when it is first used
        lands[:] = (everyone + first) % len(terrains)
        physics.reset(everyone, base.repeat(worlds, 1), upright.repeat(worlds, 1), default, lands)
        physics.step(default)
        if camera is not None:
            camera.render(physics.state, lands, None, rng)
    reset(everyone)
    policy_steps(25)
    count = 2 * config.steps
    seconds, images, plain = policy_steps(count)
    result = {"built_s": built, "policy_steps_a_second": count * worlds / seconds}
    result |= {"policy_steps_a_second_with_depth": count * worlds / (seconds + images)}
    result |= {"policy_step_ms": 1e3 * seconds / count, "depth_images_ms": 1e3 * images / count}
    result |= {"overflowed": physics.overflowed}
    if config.engine == "mujoco":
        result |= {"plain_rollout_steps_a_second": count * worlds / plain, "share_of_plain_rollout": plain / seconds}
    else:
        result |= physics.usage()
    return result


def plain_rollout(physics: Any, wanted: torch.Tensor) -> float:
    """Seconds of a policy step of `mujoco.rollout` alone: same models, states and threads, nothing read or written."""
    models = [physics._model(world) for world in range(physics.num_worlds)]
    control = wanted.numpy().astype(float)[:, None].repeat(physics.config.decimation, axis=1)
    began = time.perf_counter()
    physics._pool.rollout(models, physics._datas_for(models[0]), physics._full, control)
    return time.perf_counter() - began


def training(config: Config, rank: Rank) -> dict[str, Any]:
    """Whole iterations as they are trained, then the same with every part timed."""
    began = time.perf_counter()
    runner = prepared(config, rank)
    runner.begin()
    wait(rank.device)
    built = time.perf_counter() - began
    first = timed(runner, 1, rank)[0]
    timed(runner, WARM if config.graphs else 0, rank)  # graphs are captured
    each = timed(runner, config.iterations, rank)
    mean = float(all_sum(torch.tensor(sum(each) / len(each), device=rank.device))) / rank.count
    samples = config.worlds * config.steps * rank.count
    result: dict[str, Any] = {
        "built_s": built,
        "first_iteration_s": first,
        "iteration_s": mean,
        "slowest_iteration_s": max(each),
        "samples_a_second": samples / mean,
        "overhead_of_the_first_s": built + first - mean,
        "gpu_memory_gib": used_memory(rank.device),
    }
    if config.split:
        result["parts_s"] = parts(runner, config.split, rank)
    return result


def compare(config: Config, rank: Rank) -> None:
    """Iterations without and with graphs, one after the other; ends with a short table."""
    lines = [
        f"{'worlds':>7} {'graphs':>7} {'collect':>9} {'update':>9} {'samples/s':>11} {'first':>7} {'memory':>9}  check"
    ]
    for worlds in config.compare:
        for graphs in (False, True):
            own = replace(config, worlds=worlds, graphs=graphs, compare=())
            result: dict[str, Any] = {"config": asdict(replace(own, out=Path())), "machine": machine(rank)}
            name = f"{worlds:>7} {'on' if graphs else 'off':>7}"
            try:
                t = result["training"] = halves(own, rank)
                seconds = f"{t['collect_s']:8.3f}s {t['update_s']:8.3f}s {t['samples_a_second']:11,.0f}"
                memory = 0.0 if t["gpu_memory_gib"] is None else t["gpu_memory_gib"]
                check = f"reward {t['reward']:.4f}, {t['episodes']:.0f} episodes of {t['length']:.1f} steps"
                lines.append(f"{name} {seconds} {t['first_iterations_s']:6.1f}s {memory:6.1f}GiB  {check}")
                shares = [f"{part} {1e3 * s:.0f}" for part, s in by_size(t.get("parts_s", {}))]
                lines += [f"{'':16}ms, waiting for each: {' | '.join(shares)}"] if shares else []
            except Exception as error:  # the others are still worth having
                traceback.print_exc()
                result["training"] = {"failed": f"{type(error).__name__}: {error}"}
                lines.append(f"{name} failed: {type(error).__name__}: {str(error)[:150]}")
            store(replace(own, label=config.label + f"graphs_{'on' if graphs else 'off'}_{worlds}"), result, rank)
            gc.collect()  # a runner and its graphs hold each other
            if rank.device.type == "cuda":
                torch.cuda.empty_cache()
    try:
        lines.append(differences(config, rank))
    except Exception as error:
        traceback.print_exc()
        lines.append(f"graphs were not compared bit by bit: {type(error).__name__}: {str(error)[:150]}")
    print("\n".join(["", f"{result['machine']['gpu'] or 'CPU'}, {config.steps} steps an iteration", *lines]))


def differences(config: Config, rank: Rank, worlds: int = 300, steps: int = 60) -> str:
    """Whether graphs give the same bits. Robots stand as if frozen: the engine's own sums have no fixed order."""
    task = ParkourConfig()
    task = replace(
        task, depth=replace(task.depth, use=config.depth), termination=replace(task.termination, seconds=1.0)
    )
    envs = [environment(replace(config, worlds=worlds, graphs=graphs), rank, task) for graphs in (False, True)]
    envs[0].padded = envs[1].padded
    for env in envs:
        env.physics.step = lambda targets, env=env: env.physics.state
        env.reset()
    rng, ended = torch.Generator(rank.device).manual_seed(0), 0
    for step in range(steps):
        actions = torch.randn(worlds, envs[0].num_actions, generator=rng, device=rank.device)
        off, on = (env.step(actions) for env in envs)
        for name in ("actor", "critic", "depth", "reward", "terminated", "truncated"):
            a, b = (getattr(s.observation if hasattr(s.observation, name) else s, name) for s in (off, on))
            if a is not None and not torch.equal(a, b):
                worst = float((a.float() - b.float()).abs().max())
                rows = int((a != b).flatten(1).any(1).sum() if a.ndim > 1 else (a != b).sum())
                return f"graphs change {name} of {rows} worlds at step {step}, by at most {worst:.3g}"
        ended += off.ended or 0
    return (
        f"graphs change no bit of observations, rewards and ends in {steps} steps of {worlds} worlds, {ended} restarts"
    )


def halves(config: Config, rank: Rank) -> dict[str, Any]:
    """Seconds of collecting and of updating, and figures of the episodes: without and with graphs they must agree."""
    runner = prepared(config, rank)
    first = sum(timed(runner, WARM, rank))
    rows = [runner.iterate() for _ in range(config.iterations)]
    mean = {
        name: sum(row[name] for row in rows) / len(rows) for name in ("collect_s", "update_s", "reward", "episodes")
    }
    ended = [row for row in rows if row["episodes"]]
    mean["length"] = sum(row["length"] * row["episodes"] for row in ended) / max(
        sum(row["episodes"] for row in ended), 1
    )
    seconds = mean["collect_s"] + mean["update_s"]
    result: dict[str, Any] = {"first_iterations_s": first, "iteration_s": seconds, **mean}
    result |= {"slowest_collect_s": max(row["collect_s"] for row in rows)}
    result |= {"samples_a_second": config.worlds * config.steps * rank.count / seconds}
    result |= {"gpu_memory_gib": used_memory(rank.device)}
    if config.split:
        result["parts_s"] = parts(runner, config.split, rank)
    return result


def prepared(config: Config, rank: Rank) -> Runner:
    """Environment, policy and learner, as `realsim pretrain` makes them."""
    task = ParkourConfig()
    env = environment(config, rank, replace(task, depth=replace(task.depth, use=config.depth)))
    learner = PPOConfig(steps=config.steps, bfloat16=config.bfloat16)
    policy = policies.new(env.layout, learner.networks, config.robot, 0)
    return Runner(env, policy, learner, rank=rank)


def environment(config: Config, rank: Rank, task: ParkourConfig) -> ParkourEnv:
    return make(
        task,
        courses(config),
        robot=config.robot,
        worlds=config.worlds,
        engine=config.engine,
        physics=settings(config, rank),
        rows=ROWS if config.terrain == "grid" else 1,
        seed=rank.index,
        graphs=config.graphs,
    )


def timed(runner: Runner, iterations: int, rank: Rank) -> list[float]:
    """Seconds of each."""
    seconds = []
    for _ in range(iterations):
        wait(rank.device)
        began = time.perf_counter()
        runner.iterate()
        wait(rank.device)
        seconds.append(time.perf_counter() - began)
    return seconds


def parts(runner: Runner, iterations: int, rank: Rank) -> dict[str, float]:
    """Seconds an iteration of each part, with a wait around every call."""
    env = runner.env
    assert isinstance(env, ParkourEnv)
    watch = Stopwatch(lambda: wait(rank.device))
    watch.watch(env.physics, "step", "physics")
    if env.graphs:  # what is inside a graph cannot be told apart
        watch.watch(env, "_acting", "graph: targets, pushes")
        watch.watch(env, "_looking", "graph: observations, rewards, rays")
        watch.watch(env, "_restarting", "graph: resets")
        watch.watch(env, "step", "between the graphs")
        watch.watch(runner, "_acting", "graph: inference")
        watch.watch(runner, "_keeping", "graph: storage")
        watch.watch(runner.ppo, "finish", "storage")
        watch.watch(runner.ppo, "update", "update")
        watch.watch(runner, "iterate", "the rest")
        return split(runner, iterations, watch)
    for method in ("reset", "set_params", "set_velocity"):
        watch.watch(env.physics, method, "resets: engine")
    casters = {id(c): c for c in (getattr(env.camera, "caster", None), getattr(env.probe, "caster", None)) if c}
    for caster in casters.values():
        watch.watch(caster, "cast", "rays")
    watch.watch(env, "_restart", "resets: task")
    watch.watch(env, "step", "observations, rewards")
    watch.watch(runner.ppo, "act", "inference")
    watch.watch(runner.policy.critic, "of", "inference")
    for method in ("see", "add", "finish", "carry"):
        watch.watch(runner.rollout, method, "storage")
    watch.watch(runner.ppo, "update", "update")
    watch.watch(runner, "iterate", "the rest")
    return split(runner, iterations, watch)


def split(runner: Runner, iterations: int, watch: Stopwatch) -> dict[str, float]:
    for _ in range(iterations):
        runner.iterate()
    return {part: seconds / iterations for part, seconds in watch.seconds.items()}


def courses(config: Config) -> list[Any]:
    return [flat()] if config.terrain == "flat" else grid(0)


def settings(config: Config, rank: Rank) -> PhysicsConfig:
    return PhysicsConfig(
        self_collision=config.self_collision,
        device=str(rank.device),
        threads=config.threads,
        iterations=config.newton,
        contacts_per_world=config.contacts,
        constraints_per_world=config.constraints,
        broadphase=config.broadphase,
        jacobian=config.jacobian,
    )


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def used_memory(device: torch.device) -> float | None:
    """GiB in use on the device by torch, Warp and all else; None on the CPU."""
    if device.type != "cuda":
        return None
    free, total = torch.cuda.mem_get_info(device)
    return (total - free) / 2**30


def machine(rank: Rank) -> dict[str, Any]:
    """What it was measured on."""
    gpu = torch.cuda.get_device_name(rank.device) if rank.device.type == "cuda" else None
    versions = {name: version(name) for name in ("torch", "warp", "mujoco", "mujoco_warp")}
    cores = len(os.sched_getaffinity(0))
    return {"gpu": gpu, "processes": rank.count, "cores": cores, "python": platform.python_version(), **versions}


def version(package: str) -> str | None:
    from importlib import import_module

    try:
        return str(getattr(import_module(package), "__version__", None))
    except ImportError:
        return None


def label(config: Config, rank: Rank) -> str:
    eyes = "depth" if config.depth else "blind"
    made = f"{config.engine} {config.robot} {config.terrain} {config.worlds}x{config.steps} {eyes} x{rank.count}"
    return config.label or made


def store(config: Config, result: dict[str, Any], rank: Rank) -> None:
    """Add this run to the file, beside those with other labels."""
    Store(config.out, ("case",)).add({"case": label(config, rank), **result})


def table(config: Config, result: dict[str, Any], rank: Rank) -> list[str]:
    """The figures, a line each."""
    lines = ["", f"{label(config, rank)}   on {result['machine']['gpu'] or platform.processor() or 'CPU'}"]
    for section in ("engine", "training"):
        for name, value in result.get(section, {}).items():
            if name == "parts_s":
                lines += [f"    {p:<32}{1e3 * s:10.1f} ms an iteration" for p, s in by_size(value)]
            else:
                shown = f"{value:14,.3f}" if isinstance(value, float) else f"{value!s:>14}"
                lines.append(f"  {section}: {name:<36}{shown}")
    return lines


def by_size(values: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(values.items(), key=lambda item: -item[1])


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
