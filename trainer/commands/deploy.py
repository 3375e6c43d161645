"""`realsim deploy`: the loop that runs on the robot, here with MuJoCo in its place."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from realsim.cli.commands import CommandResult
from realsim.core.progress import steps
from trainer.config import DeployConfig
from trainer.errors import TrainerError
from trainer.robots import TrainedRobot, named

if TYPE_CHECKING:  # imports torch
    from trainer.ppo.export import Deployment

SHOWN_EVERY = 25
"""Policy steps between two looks at the progress: the loop is timed."""


def body_of(facts: Deployment, policy: Path) -> TrainedRobot:
    """The robot that a policy was trained on.

    Raises:
        RealsimError: no robot of that name, or the policy names other joints.
    """
    body = named(facts.robot, policy)
    other = [name for name in facts.layout.actions if name not in body.joints]
    if tuple(body.joints) != facts.layout.actions:
        raise TrainerError(
            "the policy moves other joints than the robot has",
            file=policy,
            expected=f"the {len(body.joints)} joints of {facts.robot}, in their order",
            found=", ".join(other[:4]) or "the same in another order, or fewer",
        )
    return body


def deploy(
    policy: Annotated[Path, tyro.conf.Positional],
    config: DeployConfig,
    scene: str = "flat",
    log: Path | None = None,
    seed: int = 0,
) -> CommandResult:
    """Run an exported policy in a 50 Hz loop on a simulated robot; latencies are measured.

    A real robot is a class with four methods in its place: docs/deploy.md.

    Args:
        policy: policy.onnx.
        scene: where the simulated robot stands: a folder of `realsim reconstruct`, or the name of a terrain.
        log: folder of a case for `realsim diagnose` and `realsim close`; a further run is added to those there.
        seed: of where on the start platform the robot stands; 0 is its middle.
    """
    from trainer.commands import common
    from trainer.deploy.log import CaseLog
    from trainer.deploy.loop import deploy as run_loop
    from trainer.deploy.mujoco import MujocoRobot
    from trainer.ppo import export

    session, facts = export.load(policy)
    terrain, _ = common.find_terrain(scene)
    body = body_of(facts, policy)
    robot = MujocoRobot(body, terrain, depth=facts.layout.depth is not None, seed=seed)
    case = None if log is None else CaseLog(log, body, terrain, policy, facts, config)
    steps_begun = count()
    with steps() as tick:

        def ended() -> bool:
            begun = next(steps_begun)
            if begun % SHOWN_EVERY == 0:
                tick("running the policy", min(1.0, begun * facts.policy_dt / config.seconds))
            return robot.arrived()

        report = run_loop(robot, session, facts, config, until=ended, steer=robot.steer, log=case)
    figures = report.figures()
    if report.reason == "done" and robot.arrived():
        figures["reason"] = "goal"
    x, y, z = robot.position
    think, whole = figures["inference_ms"], figures["latency_ms"]
    lines = [
        f"ended          {figures['reason']} after {report.steps} steps ({report.steps * facts.policy_dt:.1f} s)",
        f"position       {x:.2f} {y:.2f} {z:.2f} m",
        f"inference      {think['p50']:.2f} ms median, {think['p99']:.2f} ms at the 99th percentile",
        f"read to write  {whole['p50']:.2f} ms median, {whole['p99']:.2f} ms (the simulation's step included)",
        f"late           {report.late} steps; {report.clipped} joint targets clipped",
        *([] if case is None else [f"log            {log}, {len(case.runs)} runs"]),
    ]
    return CommandResult("\n".join(lines), {**figures, "position": [x, y, z], "robot": facts.robot})
