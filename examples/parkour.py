"""Frames to scene to tuned policy to video, with a clock.

    python examples/parkour.py                           a course of stakes, rendered here as a depth camera sees it
    python examples/parkour.py --frames my_capture       frames of your own
    python examples/parkour.py --terrain beams:0.8:3 --minutes 4
    python examples/parkour.py --scene my_scene --no-videos   where there is a GPU, but neither open3d nor a renderer

Writes scene/, tuned/, before.mp4, after.mp4 and clock.json into --out. Fine-tuning needs a GPU: on a CPU the same
minutes teach next to nothing.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

import realsim as rs
from realsim.synth.capture import write_capture
from realsim.synth.config import SynthConfig
from trainer.commands.common import find_terrain, load_policy
from trainer.commands.task_file import load_task
from trainer.evaluate import EvaluationConfig, Setting, evaluate, trial_env
from trainer.physics import PhysicsConfig
from trainer.policies import TASKS, base_of
from trainer.ppo.config import LoopConfig
from trainer.ppo.distributed import pick_device
from trainer.replay import record, write
from trainer.robots import ROBOTS
from trainer.terrain.rendered import in_room
from trainer.terrain.scene import load
from trainer.trainers import Scene, TrainConfig, find
from trainer.trainers.ladder import HELP_BELOW, helped


@dataclass(frozen=True)
class Options:
    frames: Path | None = None
    """A capture; without one the terrain below is rendered."""
    scene: Path | None = None
    """A scene that is reconstructed already; the clock begins after it."""
    terrain: str = "stakes:0.6:21"
    """Generated course: FAMILY:DIFFICULTY:SEED, or the name of a test."""
    minutes: float = 3.0
    """Of fine-tuning."""
    trials: int = 200
    """Before and after."""
    worlds: int = 0
    """Simulated robots; 0 takes 4096 on a GPU and 64 on the CPU."""
    task_file: Path = TASKS["g1"]
    """What differs from the paper's task."""
    videos: bool = True
    """One trial before and one after."""
    device: str = "auto"
    out: Path = Path("parkour")


def main(options: Options) -> None:
    clock: dict[str, float] = {}
    capture = None if options.scene else options.frames or rendered(options)
    began = time.perf_counter()

    def lap(what: str) -> None:
        clock[what] = round(time.perf_counter() - began - sum(clock.values()), 1)
        print(f"{what:<24} {clock[what]:7.1f} s", flush=True)

    if capture is not None:
        print(f"scene: {rs.reconstruct(capture, options.out / 'scene', overwrite=True).verdict}")
        lap("frames to scene")

    terrain, base = load(options.scene or options.out / "scene"), base_of("g1")
    task = load_task(options.task_file)
    device = pick_device(options.device)
    setting = Setting(
        "g1", "warp" if device.type == "cuda" else "mujoco", task=task, physics=PhysicsConfig(device=str(device))
    )
    many = EvaluationConfig(trials=options.trials)

    def rate(file: Path) -> float:
        return evaluate(load_policy(file).to(device).act, terrain, many, setting).success

    before = rate(base)
    lap("trials of the base")
    scene = Scene((terrain,))
    if before < HELP_BELOW:
        scene, task = helped(scene, task)
    config = TrainConfig(
        worlds=options.worlds,
        device=options.device,
        task=task,
        loop=LoopConfig(iterations=100_000, minutes=options.minutes, stop_at_target=True),
    )
    tuned = find("ppo")(scene, base, config, options.out / "tuned")
    lap("fine-tuning")
    after = rate(tuned.policy)
    lap("trials of the tuned one")
    for name, file in (("before", base), ("after", tuned.policy)) if options.videos else ():
        policy = load_policy(file)
        env = trial_env(terrain, 1, EvaluationConfig(randomise=False), Setting("g1", "mujoco", task=task))
        trial = record(policy.act, env, 0)
        write(trial, ROBOTS["g1"](), terrain, options.out / f"{name}.mp4")
        print(f"{name}: {trial.outcome}")
    if options.videos:
        lap("videos")
    print(f"success {before:.1%} -> {after:.1%} in {sum(clock.values()) / 60:.1f} minutes on {device}")
    found = {"seconds": clock, "before": before, "after": after, "iterations": tuned.iterations, "device": str(device)}
    (options.out / "clock.json").write_text(json.dumps(found, indent=1))


def rendered(options: Options) -> Path:
    """A capture of the generated course, not counted by the clock."""
    terrain, _ = find_terrain(options.terrain)
    return write_capture(options.out / "frames", SynthConfig(), terrain=in_room(terrain), overwrite=True).capture


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
