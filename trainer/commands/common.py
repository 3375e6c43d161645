"""Shared parts of the trainer's commands. Imported first, so that a missing package is reported at once."""

import os
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from realsim.core.errors import MissingExtraError, UnknownNameError
from realsim.core.files import check_room, refuse_existing

if find_spec("torch") is None:
    raise MissingExtraError("torch", "train", "training and running policies")

import torch

from trainer import terrain as terrains
from trainer.config import Evaluation
from trainer.errors import TrainerError
from trainer.evaluate import Setting
from trainer.physics import PhysicsConfig
from trainer.ppo import checkpoint, export
from trainer.ppo.policy import Policy, check_layout
from trainer.robots import named
from trainer.tasks.parkour.observations import layout
from trainer.terrain import Terrain
from trainer.terrain.scene import load as load_scene
from trainer.trainers import Scene, TrainConfig, TrainResult


def find_terrain(name: str) -> tuple[Terrain, Path | None]:
    """A reconstructed scene's folder, one of the thirteen named tests, `flat`, or FAMILY:DIFFICULTY:SEED."""
    if Path(name).is_dir():
        return load_scene(name), Path(name)
    if name == "flat":
        return terrains.flat(), None
    if name in terrains.TESTS:
        return terrains.named(name), None
    family, _, rest = name.partition(":")
    if family in terrains.FAMILIES:
        difficulty, _, seed = rest.partition(":")
        try:
            return terrains.generate(family, float(difficulty or 0.5), int(seed or 0)), None
        except ValueError as error:
            raise TrainerError("not a terrain", expected="FAMILY:DIFFICULTY:SEED", found=name) from error
    if os.sep in name or name.startswith(".") or Path(name).exists():
        raise TrainerError("there is no such scene", file=name, expected="a folder written by `realsim reconstruct`")
    known = {"flat", *terrains.TESTS, *terrains.FAMILIES}
    raise UnknownNameError("scene (neither a folder nor a terrain)", name, known, otherwise="check the path")


def find_scene(names: Sequence[str]) -> Scene:
    """One terrain or several."""
    if not names:
        raise TrainerError("no scene was named", expected="folders of reconstructed scenes, or names of terrains")
    found = [find_terrain(name) for name in names]
    return Scene(tuple(t for t, _ in found), folders=tuple(f for _, f in found if f is not None))


def load_policy(path: Path) -> Policy:
    """A trained policy (.pt), or an exported one (.onnx), for trials.

    Raises:
        TrainerError: no policy, or an exported one with another robot's gains.
    """
    return export.as_policy(path, named) if path.suffix == ".onnx" else checkpoint.load(path)[0]


def setting(policy: Policy, file: Path, device: torch.device, config: TrainConfig) -> Setting:
    """The simulation for trials of a policy, after it was found to fit the task.

    Raises:
        TrainerError: another robot, or another observation layout; the term that differs is named.
    """
    if config.robot and config.robot != policy.robot:
        raise TrainerError("the policy is for another robot", file=file, expected=config.robot, found=policy.robot)
    robot = named(policy.robot, file)
    task = config.task
    if policy.layout.depth is None or robot.camera is None:
        task = replace(task, depth=replace(task.depth, use=False))
    depth = None if not task.depth.use or robot.camera is None else (task.depth.frames, *robot.camera.crop[::-1])
    check_layout(policy.layout, layout(robot, task.observation, depth, task.depth.stride), str(file))
    engine = config.engine or ("warp" if device.type == "cuda" else "mujoco")
    physics = PhysicsConfig(device=str(device), seed=config.seed)
    return Setting(policy.robot, engine, None, task, physics, config.diagnosis)


_ROOM = 50e6
"""Bytes: a checkpoint of the policies that ship is 11 MB, and is written beside the one that it replaces."""


def check_output(out: Path, overwrite: bool, config: TrainConfig) -> None:
    """Refuse a folder that holds another run, or anything else, or has no room; a run that is resumed may be in it."""
    if first_rank() and (config.resume is None or out.resolve() not in config.resume.resolve().parents):
        refuse_existing(out, overwrite, ("policy.pt", "history.jsonl", "result.json"))
    if first_rank():
        check_room(out, _ROOM, "the disk has no room for a training's results")


def first_rank() -> bool:
    """Whether this process, one of several under torchrun, is the one that reports."""
    return os.environ.get("RANK", "0") == "0"


def trial_lines(title: str, evaluation: Evaluation) -> list[str]:
    """A line a terrain: rate, interval, most frequent causes of failure."""
    lines = []
    for r in evaluation.results:
        causes = ", ".join(f"{cause} {count}" for cause, count in r.reasons.items())
        low, high = r.interval
        text = f"{r.rate:6.1%}  ({low:.1%} to {high:.1%}, {r.successes} of {r.trials})"
        extra = " on finer contact" if r.geometry == "finer" else ""
        lines.append(f"{title:<14} {r.terrain}{extra}: {text}{'; failed: ' + causes if causes else ''}")
    return [*lines, *(f"{'warning':<14} {w}" for w in evaluation.warnings)]


def result_lines(result: TrainResult, target: float) -> list[str]:
    """Summary lines of a training."""
    if result.to_target is None:
        reached = "not reached" if result.evaluations else "not requested (no evaluations on the way)"
    else:
        reached = str(result.to_target)
    return [
        f"policy         {result.policy}" + (f", {result.onnx}" if result.onnx else ""),
        f"iterations     {result.iterations} with {result.worlds} worlds of {result.robot}, {result.seconds:.0f} s",
        f"to {target:.0%}         {reached}",
        *(f"note           {w}" for w in result.warnings),
    ]
