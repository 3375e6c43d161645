"""Whether a robot is simulated as its file means: it is stood up, dropped, and its joints are moved one by one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch

from trainer.physics import ENGINES, PhysicsConfig
from trainer.robots.base import TrainedRobot
from trainer.robots.derive import touching
from trainer.terrain import flat

SECONDS = 2.0
DROP_M = 0.1
SWING_RAD = 0.3
FOLLOWS = 0.5
"""Share of a slow swing of 0.3 rad that a joint must make in the air; those of the robots that ship make 0.8 to 1."""
SAG_RAD = 0.35
"""More than this a joint should not sag where the robot stands; Go2's sag by 0.24."""
_LEAN = 0.9
"""Least cosine of the base's tilt that is still upright."""


@dataclass(frozen=True)
class Finding:
    """One thing that was tried."""

    level: str
    """good, look or bad."""
    text: str


def check(robot: TrainedRobot) -> list[Finding]:
    """What was tried on the robot, in order."""
    return [*_stands(robot), *_drops(robot), *_moves(robot), *_mirrors(robot)]


def _stands(robot: TrainedRobot) -> Iterator[Finding]:
    state, seconds = _held(robot, 0.0)
    sag = (state.joint_pos[0].numpy() - robot.default)[list(robot.legs)]
    worst = robot.joints[robot.legs[int(np.argmax(abs(sag)))]]
    if seconds < SECONDS:
        level = "look" if len(robot.feet) == 2 else "bad"
        why = "two feet need a policy" if level == "look" else "correct the default pose, kp, or the feet"
        yield Finding(level, f"stands for {seconds:.1f} s of {SECONDS:g} on its servos alone: {why}")
    else:
        weak = abs(sag).max() > SAG_RAD
        text = f"stands for {SECONDS:g} s; most sags {worst}, by {abs(sag).max():.2f} rad"
        yield Finding("look" if weak else "good", text + (": raise kp" if weak else ""))
    if seconds == SECONDS and (pairs := _touching(robot, state)):
        yield Finding("look", f"touches where it stands, beside the feet: {pairs} (exclude what overlaps)")


def _touching(robot: TrainedRobot, state: Any) -> str:
    """Pairs of bodies in contact on flat ground, but feet on it."""
    spec = robot.robot.spec.copy()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    parts = (state.base_pos[0], state.base_quat[0], state.joint_pos[0])
    data.qpos[:] = np.concatenate([x.numpy() for x in parts])
    mujoco.mj_forward(model, data)
    standing = {("world", foot) for foot in robot.feet} | {(foot, "world") for foot in robot.feet}
    return _named(touching(model, data) - standing)


def _named(pairs: set[tuple[str, ...]]) -> str:
    return ", ".join("-".join(pair) for pair in sorted(pairs))


def _drops(robot: TrainedRobot) -> Iterator[Finding]:
    state, _ = _held(robot, DROP_M)
    if state.diverged[0] or not torch.isfinite(state.base_pos).all():
        yield Finding("bad", f"dropped from {100 * DROP_M:g} cm: the simulation diverges (masses, gains)")
    else:
        at = f"{state.base_pos[0, 2]:.2f} m, its default pose at {robot.standing_height:.2f} m"
        yield Finding("good", f"dropped from {100 * DROP_M:g} cm: {SECONDS:g} s later at {at}")


def _held(robot: TrainedRobot, above: float) -> tuple[Any, float]:
    """State after `SECONDS` on flat ground with the default pose as target, and how long the base was upright."""
    physics = ENGINES["mujoco"](robot, [flat()], 1, PhysicsConfig(threads=1, self_collision=True))
    one, pose = torch.tensor([0]), torch.tensor(robot.default, dtype=torch.float32)[None]
    base = torch.tensor([[0.0, 0.0, robot.standing_height + above]])
    physics.reset(one, base, torch.tensor([[1.0, 0, 0, 0]]), pose, one)
    for k in range(round(SECONDS / physics.policy_dt)):
        state = physics.step(pose)
        _, x, y, _ = state.base_quat[0].tolist()
        upright = 1 - 2 * (x * x + y * y) > _LEAN and float(state.base_pos[0, 2]) > 0.6 * robot.standing_height
        if state.diverged[0] or not upright:
            return state, k * physics.policy_dt
    return state, SECONDS


def _moves(robot: TrainedRobot) -> Iterator[Finding]:
    """Each joint alone, in the air without gravity: whether it follows, and what touches what."""
    spec = robot.robot.spec.copy()
    spec.option.gravity = [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    data, lame = mujoco.MjData(model), []
    met: set[tuple[str, ...]] = set()
    for j, name in enumerate(robot.joints):
        mujoco.mj_resetData(model, data)
        data.qpos[7:], data.qpos[2] = robot.default, 2.0
        room = (robot.lower[j] - robot.default[j], robot.upper[j] - robot.default[j])
        goal = float(np.clip(SWING_RAD if room[1] >= -room[0] else -SWING_RAD, *room))
        for k in range(steps := round(1.0 / model.opt.timestep)):
            data.ctrl[:] = robot.default
            data.ctrl[j] += goal * min(1.0, 2 * k / steps)
            mujoco.mj_step(model, data)
            met |= touching(model, data)
        if (data.qpos[7 + j] - robot.default[j]) / goal < FOLLOWS:
            lame.append(name)
    yield (
        Finding("bad", f"does not follow its servo: {', '.join(lame)} (kp, effort)")
        if lame
        else Finding("good", f"{len(robot.joints)} joints follow their servos")
    )
    if met:
        text = f"links that touch each other near the default pose: {_named(met)} (exclude what overlaps)"
        yield Finding("look", text)


def _mirrors(robot: TrainedRobot) -> Iterator[Finding]:
    """A pose and its mirror image have mirrored feet."""
    index, sign = (np.array(x) for x in robot.mirror)
    q = robot.default + np.random.default_rng(0).uniform(-0.1, 0.1, len(robot.joints))
    model = robot.robot.spec.compile()

    def feet(joints: Any) -> Any:
        data = mujoco.MjData(model)
        data.qpos[:7], data.qpos[7:] = [0, 0, 0, 1, 0, 0, 0], joints
        mujoco.mj_kinematics(model, data)
        return np.array([data.body(f).xpos for f in robot.feet])

    swapped = [k ^ 1 for k in range(len(robot.feet))]
    off = float(abs(feet(q)[swapped] * [1, -1, 1] - feet(sign * q[index])).max())
    pose = float(abs(sign * robot.default[index] - robot.default).max())
    bad = off > 0.01 or pose > 0.01
    text = f"left and right mirror each other to {1000 * off:.1f} mm at the feet, {pose:.3f} rad in the default pose"
    yield Finding("bad" if bad else "good", text)
