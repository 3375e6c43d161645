"""`realsim deploy`: the loop that runs on the robot, here with MuJoCo in its place."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Annotated

import tyro

from realsim.commands import CommandResult
from realsim.progress import steps
from trainer.deploy.config import DeployConfig
from trainer.robots import named

SHOWN_EVERY = 25
"""Policy steps between two looks at the progress: the loop is timed."""


def deploy(
    policy: Annotated[Path, tyro.conf.Positional],
    config: DeployConfig,
    scene: str = "flat",
) -> CommandResult:
    """Run an exported policy in a 50 Hz loop on a simulated robot; latencies are measured.

    A real robot is a class with four methods in its place: docs/deploy.md.

    Args:
        policy: policy.onnx.
        scene: where the simulated robot stands: a folder of `realsim reconstruct`, or the name of a terrain.
    """
    from trainer.commands import common
    from trainer.deploy.loop import deploy as run_loop
    from trainer.deploy.mujoco import MujocoRobot
    from trainer.ppo import export

    session, facts = export.load(policy)
    terrain, _ = common.find_terrain(scene)
    body = named(facts.robot, policy)
    if tuple(body.joints) != facts.layout.actions:
        raise common.TrainerError("the policy moves other joints than the robot has", file=policy, found=facts.robot)
    robot = MujocoRobot(body, terrain, depth=facts.layout.depth is not None)

    def arrived() -> bool:
        return bool(terrain.goal.contains(robot.position[None, :2])[0])

    steps_begun = count()
    with steps() as tick:

        def ended() -> bool:
            begun = next(steps_begun)
            if begun % SHOWN_EVERY == 0:
                tick("running the policy", min(1.0, begun * facts.policy_dt / config.seconds))
            return arrived()

        report = run_loop(robot, session, facts, config, until=ended, steer=robot.steer)
    figures = report.figures()
    if report.reason == "done" and arrived():
        figures["reason"] = "goal"
    x, y, z = robot.position
    think, whole = figures["inference_ms"], figures["latency_ms"]
    lines = [
        f"ended          {figures['reason']} after {report.steps} steps ({report.steps * facts.policy_dt:.1f} s)",
        f"position       {x:.2f} {y:.2f} {z:.2f} m",
        f"inference      {think['p50']:.2f} ms median, {think['p99']:.2f} ms at the 99th percentile",
        f"read to write  {whole['p50']:.2f} ms median, {whole['p99']:.2f} ms (the simulation's step included)",
        f"late           {report.late} steps; {report.clipped} joint targets clipped",
    ]
    return CommandResult("\n".join(lines), {**figures, "position": [x, y, z], "robot": facts.robot})
