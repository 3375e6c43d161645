"""The loop on the robot: read, think, write, every 20 ms, and stop rather than do something wild."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trainer.config import DeployConfig
from trainer.deploy.observer import Observer
from trainer.deploy.robot import Reading, Robot
from trainer.errors import TrainerError
from trainer.ppo.export import Deployment
from trainer.ppo.metadata import check_network

if TYPE_CHECKING:
    from trainer.deploy.log import CaseLog


@dataclass
class Report:
    """Summary of a run of the loop."""

    reason: str = "done"
    """Why it ended: done, tilted, late, or what was refused."""
    steps: int = 0
    late: int = 0
    """Steps whose action came after the next was due."""
    clipped: int = 0
    """Joint targets that were too far away."""
    inference_s: list[float] = field(default_factory=list)
    """The network alone, a step."""
    latency_s: list[float] = field(default_factory=list)
    """From the reading to the written targets, a step."""

    def figures(self) -> dict[str, Any]:
        """Milliseconds at the median and the 99th percentile, and the longest."""

        def ms(values: list[float]) -> dict[str, float]:
            v = np.asarray(values or [math.nan]) * 1e3
            return {"p50": float(np.median(v)), "p99": float(np.percentile(v, 99)), "max": float(v.max())}

        return {
            "reason": self.reason,
            "steps": self.steps,
            "late": self.late,
            "clipped": self.clipped,
            "inference_ms": ms(self.inference_s),
            "latency_ms": ms(self.latency_s),
        }


def deploy(
    robot: Robot,
    session: Any,
    facts: Deployment,
    config: DeployConfig,
    *,
    until: Callable[[], bool] | None = None,
    steer: Callable[[float], NDArray[np.float64]] | None = None,
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
    log: CaseLog | None = None,
) -> Report:
    """Drive a robot by a policy until the time is over or something is wrong; the robot is stopped in any case, and
    what was logged until then is written.

    Args:
        robot: see `Robot`.
        session: the policy, (session, facts) of `trainer.ppo.export.load`.
        facts: its metadata.
        config: see `DeployConfig`.
        until: asked every step; true ends the run.
        steer: for a policy that is steered (`ObservationConfig.steered`): speed in m/s -> (3,) velocity ahead and to
            the left in m/s, yaw rate in rad/s. Others are told to go straight ahead.
        clock, sleep: seconds; for tests.
        log: gets every step; written after the robot has stopped.

    Raises:
        TrainerError: a policy that is to be steered, and nobody who steers.
    """
    observe = Observer(facts)
    if observe.steered and steer is None:
        raise TrainerError(
            "the policy was trained to be steered",
            expected="steer=, a function that gives the direction",
            hint="a joystick, or localisation relative to the goal",
        )
    scale, default = np.asarray(facts.action_scale), np.asarray(facts.default)
    action = np.zeros(len(default), np.float32)
    report = Report()
    check_network(session, facts.layout)  # the first call allocates, and may fail: not while the robot waits
    try:  # from here on the robot may hold gains of ours, also where `start` itself fails half way
        robot.start(np.asarray(facts.kp), np.asarray(facts.kd))
        began = due = clock()
        late = 0
        while report.steps * facts.policy_dt < config.seconds and not (until is not None and until()):
            started = clock()
            reading = robot.read()
            if (broken := _broken(reading, default)) is not None:
                report.reason = f"the robot's {broken}"
                break
            if -reading.gravity[2] < math.cos(config.max_tilt):
                report.reason = "tilted"
                break
            speed = config.speed * (min(1.0, report.steps * facts.policy_dt / config.ramp) if config.ramp else 1.0)
            ahead = np.array([speed, 0.0, 0.0])
            command = steer(speed) if observe.steered and steer is not None else ahead
            inputs = observe(reading, command, action)
            thought = clock()
            try:
                action = session.run(None, inputs)[0][0]
            except Exception as error:  # onnxruntime's own exception classes share no base but this
                report.reason = f"the policy failed: {str(error).partition(chr(10))[0]}"
                break
            report.inference_s.append(clock() - thought)
            if not np.isfinite(action).all():
                report.reason = "the policy's action is not a number"
                break
            if facts.action_limit is not None:  # as in training, where the policy then sees what was left of it
                action = np.clip(action, -facts.action_limit, facts.action_limit)
            wanted = default + scale * action
            targets = np.clip(wanted, reading.joint_pos - config.max_step, reading.joint_pos + config.max_step)
            report.clipped += int((targets != wanted).sum())
            robot.write(targets)
            if log is not None:
                passed = started - began if config.realtime else report.steps * facts.policy_dt
                log.add(
                    passed if reading.time is None else reading.time, reading, inputs, command, speed, action, targets
                )
            report.latency_s.append(clock() - started)
            report.steps += 1
            due += facts.policy_dt
            now = clock()
            missed = config.realtime and now > due
            late = late + 1 if missed else 0
            report.late += missed
            if late >= config.max_late:
                report.reason = "late"
                break
            if missed:
                # What was lost stays lost: an action is to be held for a step, the next takes at least so long to come.
                due = now + max(0.0, facts.policy_dt - min(report.latency_s))
            if config.realtime:
                sleep(max(0.0, due - clock()))
    except BaseException as error:
        report.reason = f"{type(error).__name__}: {error}"
        raise
    finally:
        robot.stop()
        if log is not None:
            log.write(report.figures())
    return report


def _broken(reading: Reading, default: NDArray[np.float64]) -> str | None:
    """What is wrong with the first part of a reading that the policy would be misled by; depth may miss pixels."""
    for name in ("gravity", "ang_vel", "joint_pos", "joint_vel"):
        if not np.isfinite(getattr(reading, name)).all():
            return f"{name} is not a number"
    if (abs(reading.joint_pos - default) > 4 * np.pi).any():  # targets stay near readings, and would follow
        return "joint_pos is more than two turns from the default pose"
    return None
