"""How fast training is: seconds of collecting and of updating, and samples a second.

    python benchmarks/training/trainer_speed.py                 one GPU, G1, 4096 worlds x 24 steps, depth
    python benchmarks/training/trainer_speed.py --no-graphs     the same without CUDA graphs
    torchrun --nproc-per-node 2 benchmarks/training/trainer_speed.py                the same on each of two GPUs
    python benchmarks/training/trainer_speed.py --engine mujoco --worlds 128        the CPU engine

Robots act at random, as an untrained policy does, on the curriculum's 200 terrains, so that many lie on the ground:
physics is at its slowest. Rewards and lengths of episodes are kept beside the seconds: with and without graphs they
must agree.
"""

import os
import platform
import sys
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import torch
import tyro

from benchmarks.store import Store
from trainer.physics import PhysicsConfig
from trainer.ppo import policy as policies
from trainer.ppo.config import PPOConfig
from trainer.ppo.distributed import Rank, ranks
from trainer.ppo.runner import Runner
from trainer.tasks.parkour import ParkourConfig, make
from trainer.terrain import flat, grid

RESULTS = Path(__file__).parents[1] / "results" / "trainer_speed.json"
WARM = 6
"""Iterations before the clock starts: kernels are compiled, and graphs of the usual sizes captured."""


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
    """Iterations timed."""
    graphs: bool = True
    """On a GPU, the task around the physics as CUDA graphs."""
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


def main(config: Config) -> None:
    """Time it, print the figures, add them to the JSON file."""
    with ranks("cpu" if config.engine == "mujoco" and config.device == "auto" else config.device) as rank:
        figures = timed(prepared(config, rank), config)
        if not rank.first:
            return
        eyes = "depth" if config.depth else "blind"
        made = f"{config.engine} {config.robot} {config.terrain} {config.worlds}x{config.steps} {eyes} x{rank.count}"
        settings = asdict(replace(config, out=Path()))
        row = {"case": config.label or made, "config": settings, "machine": machine(rank), "training": figures}
        Store(config.out, ("case",)).add(row)
        print(row["case"], *(f"  {name:<20}{value:14,.3f}" for name, value in figures.items()), sep="\n")


def prepared(config: Config, rank: Rank) -> Runner:
    """Environment, policy and learner, as `realsim pretrain` makes them."""
    task = ParkourConfig()
    env = make(
        replace(task, depth=replace(task.depth, use=config.depth)),
        [flat()] if config.terrain == "flat" else grid(0),
        robot=config.robot,
        worlds=config.worlds,
        engine=config.engine,
        physics=PhysicsConfig(
            self_collision=config.self_collision, device=str(rank.device), threads=config.threads, seed=rank.index
        ),
        rows=10 if config.terrain == "grid" else 1,
        seed=rank.index,
        graphs=config.graphs,
    )
    learner = PPOConfig(steps=config.steps)
    policy = policies.new(env.layout, learner.networks, config.robot, 0)
    return Runner(env, policy, learner, rank=rank)


def timed(runner: Runner, config: Config) -> dict[str, float]:
    """Seconds an iteration of collecting and of updating, samples a second, and figures of the episodes."""
    first = sum(seconds(runner.iterate()) for _ in range(WARM))
    rows = [runner.iterate() for _ in range(config.iterations)]
    names = ("collect_s", "update_s", "reward", "episodes")
    mean = {name: sum(row[name] for row in rows) / len(rows) for name in names}
    steps = sum(row["length"] * row["episodes"] for row in rows if row["episodes"])
    iteration = mean["collect_s"] + mean["update_s"]
    return {
        **mean,
        "length": steps / max(1.0, sum(row["episodes"] for row in rows)),
        "first_iterations_s": first,
        "iteration_s": iteration,
        "slowest_iteration_s": max(map(seconds, rows)),
        "samples_a_second": config.worlds * config.steps * runner.rank.count / iteration,
    }


def seconds(row: dict[str, float]) -> float:
    return row["collect_s"] + row["update_s"]


def machine(rank: Rank) -> dict[str, Any]:
    """What it was measured on."""
    gpu = torch.cuda.get_device_name(rank.device) if rank.device.type == "cuda" else None
    versions = {name: version(name) for name in ("torch", "warp-lang", "mujoco", "mujoco-warp")}
    cores = len(os.sched_getaffinity(0))
    return {"gpu": gpu, "processes": rank.count, "cores": cores, "python": platform.python_version(), **versions}


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
