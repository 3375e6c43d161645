"""mjlab as engine and learner: a scene becomes an mjlab task, its own velocity task of G1 on our terrain.

Written against mjlab 1.6's public interface and not run by us: it pins mujoco 3.11, the rest here is tested with a
newer one (docs/training.md). mjlab's observations, rewards and networks are its own, so the policy is its own too: it
starts from scratch or from a checkpoint of mjlab's, and `realsim evaluate` does not read it.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from realsim.errors import MissingExtraError
from trainer.errors import TrainerError
from trainer.robots import ROBOTS
from trainer.terrain import Terrain
from trainer.trainers.base import Scene, TrainConfig, TrainResult
from trainer.trainers.courses import add_course, extent

try:
    from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
    from mjlab.managers.termination_manager import TerminationTermCfg
    from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
    from mjlab.tasks.registry import load_env_cfg, load_rl_cfg, load_runner_cls, register_mjlab_task
    from mjlab.terrains import SubTerrainCfg, TerrainEntityCfg, TerrainGeneratorCfg
    from mjlab.terrains.terrain_generator import TerrainGeometry, TerrainOutput
except ImportError as error:
    raise MissingExtraError(str(error.name), "mjlab", "the trainer mjlab (it pins mujoco 3.11)") from error

BASE_TASK = "Mjlab-Velocity-Rough-Unitree-G1"
LOWEST = 0.25
"""Metres that the base may sink below its standing height: it has stepped off the course."""


@dataclass(kw_only=True)
class CourseCfg(SubTerrainCfg):
    """One of our terrains as a sub-terrain; difficulty and chance do nothing to it."""

    course: Terrain

    def function(self, difficulty: float, spec: mujoco.MjSpec, rng: np.random.Generator) -> TerrainOutput:
        low, _ = extent(self.course)
        offset = np.array([-low[0], -low[1], 0.0])  # patches are counted from their corner
        geoms = add_course(spec, spec.body("terrain"), self.course, offset, self.course.name)
        geometries = [TerrainGeometry(geom=geom, color=(0.6, 0.6, 0.6, 1.0)) for geom in geoms]
        return TerrainOutput(origin=self.course.start.centre + offset, geometries=geometries)


def train(scene: Scene, policy: Path | None, config: TrainConfig, out: Path) -> TrainResult:
    """See `Trainer`."""
    began = time.perf_counter()
    _refuse_what_it_cannot(config)
    task = make_task(scene, config)
    register_mjlab_task(task_id(scene), task, task, load_rl_cfg(BASE_TASK), load_runner_cls(BASE_TASK))
    agent = load_rl_cfg(BASE_TASK)
    agent.seed, agent.max_iterations = config.seed, config.loop.iterations
    device = "cuda:0" if config.device == "auto" else config.device
    env = RslRlVecEnvWrapper(ManagerBasedRlEnv(cfg=task, device=device), clip_actions=agent.clip_actions)
    out.mkdir(parents=True, exist_ok=True)
    kind = load_runner_cls(BASE_TASK) or MjlabOnPolicyRunner
    runner: Any = kind(env, asdict(agent), str(out / "events"), device)
    if policy is not None:
        runner.load(str(policy))
    runner.learn(num_learning_iterations=config.loop.iterations, init_at_random_ep_len=True)
    runner.save(str(out / "mjlab.pt"))
    runner.export_policy_to_onnx(str(out), "mjlab.onnx")
    env.close()
    return TrainResult(
        policy=out / "mjlab.pt",
        onnx=out / "mjlab.onnx",
        robot="g1",
        iterations=config.loop.iterations,
        to_target=None,
        evaluations=(),
        worlds=task.scene.num_envs,
        seconds=time.perf_counter() - began,
        warnings=("mjlab's own task and policy: `realsim evaluate` does not read it",),
        ours=False,
    )


def task_id(scene: Scene) -> str:
    """The name under which the task is registered with mjlab."""
    return "Realsim-" + "-".join(t.name for t in scene.terrains)


def make_task(scene: Scene, config: TrainConfig) -> ManagerBasedRlEnvCfg:
    """mjlab's rough velocity task of G1 with our courses as its terrain, walked from start to goal."""
    cfg = load_env_cfg(BASE_TASK)
    low, high = zip(*(extent(t) for t in scene.terrains), strict=True)
    size = np.max(np.array(high) - np.array(low), axis=0)
    cfg.scene.terrain = TerrainEntityCfg(
        terrain_type="generator",
        terrain_generator=TerrainGeneratorCfg(
            seed=config.seed,
            curriculum=True,  # one column a course, in order; without, courses would be drawn by chance
            size=(float(size[0]), float(size[1])),
            num_rows=1,
            num_cols=len(scene.terrains),
            sub_terrains={t.name: CourseCfg(course=t) for t in scene.terrains},
        ),
        max_init_terrain_level=0,
    )
    cfg.scene.num_envs = config.worlds or 4096
    cfg.seed = config.seed
    cfg.curriculum = {}  # a scene has no levels
    low_speed, high_speed = config.task.command.speed
    twist = cfg.commands["twist"]
    twist.heading_command, twist.rel_heading_envs, twist.rel_standing_envs = True, 1.0, 0.0
    twist.ranges.lin_vel_x, twist.ranges.lin_vel_y = (low_speed, high_speed), (0.0, 0.0)
    twist.ranges.heading = (0.0, 0.0)
    reset = cfg.events["reset_base"].params["pose_range"]
    c = config.task.reset
    reset |= {"x": (-c.position, c.position), "y": (-c.position, c.position), "yaw": (-c.yaw, c.yaw)}
    height = ROBOTS["g1"]().standing_height - LOWEST
    cfg.terminations["off_course"] = TerminationTermCfg(func=off_course, params={"lowest": height})
    return cfg


def off_course(env: ManagerBasedRlEnv, lowest: float) -> Any:
    """(N,) bool: the base is lower than it can be on the course (terrain tops are at z = 0 or above)."""
    return env.scene["robot"].data.root_link_pos_w[:, 2] < lowest


def _refuse_what_it_cannot(config: TrainConfig) -> None:
    if config.robot not in ("", "g1"):
        raise TrainerError("the trainer mjlab has the robot g1 only", found=config.robot)
    if config.resume is not None or config.ppo.prior.amp or config.diagnosis is not None:
        raise TrainerError("the trainer mjlab does not do --resume, --amp or --diagnosis", hint="use the trainer ppo")
