"""Reference motion for the style prior: kinematic gaits that we generate, so that nobody's data is needed.

Feet follow a trot (four feet) or a walk (two) under a base that moves level and straight; the legs follow by inverse
kinematics. It is motion without forces: a style to prefer, not one that was ever balanced. Other motion can be put in
its place: `trainer.ppo.amp.StylePrior` takes any features.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from realsim.core.types import F64
from trainer.errors import TrainerError
from trainer.robots import TrainedRobot
from trainer.tasks.parkour.observations import pose

SPEEDS = (0.3, 0.45, 0.6, 0.75)
"""m/s of the gaits."""


@dataclass(frozen=True)
class Gait:
    """A cycle of the feet."""

    period: float
    """Seconds a cycle."""
    duty: float
    """Share of the cycle that a foot stands."""
    lift: float
    """Metres that a foot is raised."""
    crouch: float
    """Metres that the base is lower than at rest: nearly straight legs reach no stride."""


TROT = Gait(0.5, 0.5, 0.06, 0.0)
WALK = Gait(0.7, 0.6, 0.08, 0.03)


def reference(robot: TrainedRobot, policy_dt: float, speeds: tuple[float, ...] = SPEEDS) -> Tensor:
    """(K, S) transition features of the robot's gait at these speeds, as `parkour.observations` makes them.

    Raises:
        TrainerError: the legs cannot reach what the gait asks for.
    """
    gait = WALK if len(robot.feet) == 2 else TROT
    poses = [_features(robot, *cycle(robot, gait, speed, policy_dt), speed, policy_dt) for speed in speeds]
    # A cycle's last pose is followed by its first.
    return torch.cat([torch.cat([p, p.roll(-1, 0)], dim=-1) for p in poses])


def cycle(robot: TrainedRobot, gait: Gait, speed: float, dt: float) -> tuple[F64, F64]:
    """((T, J) joint angles, (T, F, 3) feet relative to the base) of one cycle at `speed` m/s, rows `dt` s apart."""
    legs = _Legs(robot)
    stand = legs.feet(robot.default) + np.array([0.0, 0.0, gait.crouch])
    count = round(gait.period / dt)
    joints, feet = np.empty((count, len(robot.joints))), np.empty((count, len(robot.feet), 3))
    q = robot.default.copy()
    for step in (*range(count), *range(count)):  # twice: the first round finds the cycle, the second keeps it
        # Half a cycle between left and right, and between front and rear on the same side (feet come left, right).
        phases = [step / count + 0.5 * ((i % 2) ^ (i // 2 % 2)) for i in range(len(robot.feet))]
        target = stand + np.array([_foot(gait, speed, phase) for phase in phases])
        q = legs.reach(q, target)
        joints[step], feet[step] = q, legs.feet(q)
    return joints, feet


def _foot(gait: Gait, speed: float, phase: float) -> F64:
    """(3,) metres of a foot from where it stands at rest: back along the ground, forward through the air."""
    phase %= 1.0
    stride = speed * gait.period * gait.duty
    if phase < gait.duty:
        return np.array([stride * (0.5 - phase / gait.duty), 0.0, 0.0])
    swing = (phase - gait.duty) / (1 - gait.duty)
    ahead = 0.5 * (1 - np.cos(np.pi * swing))
    return np.array([stride * (ahead - 0.5), 0.0, gait.lift * np.sin(np.pi * swing) ** 2])


class _Legs:
    """Inverse kinematics of the legs under a base that is fixed at the origin."""

    def __init__(self, robot: TrainedRobot) -> None:
        self.model = robot.robot.spec.copy().compile()
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in robot.joints]
        self.rows = np.array([j.qposadr[0] for j in joints])
        self.columns = np.array([j.dofadr[0] for j in joints])[list(robot.legs)]
        self.robot, self.bodies = robot, [self.model.body(name).id for name in robot.feet]
        # A foot with an ankle is kept level; a point foot only has a place.
        self.level = len(robot.legs) >= 6 * len(robot.feet)

    def feet(self, q: F64) -> F64:
        """(F, 3) of the foot bodies, base axes, from the base."""
        self._place(q)
        return self.data.xpos[self.bodies].copy()

    def reach(self, q: F64, target: F64, rounds: int = 100) -> F64:
        """(J,) joint angles that put the feet at (F, 3), from a guess near by (damped least squares)."""
        q = q.copy()
        for _ in range(rounds):
            self._place(q)
            error, jacobian = self._task(target)
            if np.abs(error).max() < 1e-5:
                return q
            damped = jacobian @ jacobian.T + 1e-5 * np.eye(len(error))
            step = jacobian.T @ np.linalg.solve(damped, error)
            q[list(self.robot.legs)] += step * min(1.0, 0.3 / np.abs(step).max())
            q = np.clip(q, self.robot.lower, self.robot.upper)
        if np.abs(error).max() > 5e-3:
            raise TrainerError(
                f"the legs of {self.robot.robot.name} cannot follow the reference gait",
                found=f"{np.abs(error).max() * 1e3:.0f} mm short",
                hint="train without --amp, or give a gait of your own",
            )
        return q

    def _place(self, q: F64) -> None:
        self.data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        self.data.qpos[self.rows] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def _task(self, target: F64) -> tuple[F64, F64]:
        errors, jacobians = [], []
        for body, wanted in zip(self.bodies, target, strict=True):
            position, rotation = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
            mujoco.mj_jacBody(self.model, self.data, position, rotation, body)
            errors.append(wanted - self.data.xpos[body])
            jacobians.append(position[:, self.columns])
            if self.level:
                # Rotation vector from the foot's axes to the base's, small: half the sum of cross products of axes.
                axes = self.data.xmat[body].reshape(3, 3)
                errors.append(0.5 * np.cross(axes.T, np.eye(3)).sum(0))
                jacobians.append(rotation[:, self.columns])
        return np.concatenate(errors), np.concatenate(jacobians)


def _features(robot: TrainedRobot, joints: F64, feet: F64, speed: float, dt: float) -> Tensor:
    """(T, S/2) of a cycle; joint velocities by central differences around it."""
    count = len(joints)
    velocity = (np.roll(joints, -1, 0) - np.roll(joints, 1, 0)) / (2 * dt)

    def rows(*values: float) -> Tensor:
        return torch.tensor(values).expand(count, len(values))

    def floats(x: F64) -> Tensor:
        return torch.as_tensor(x, dtype=torch.float32)

    level, forward, still = rows(0.0, 0.0, -1.0), rows(speed, 0.0, 0.0), rows(0.0, 0.0, 0.0)
    return pose(level, forward, still, floats(joints - robot.default), floats(velocity), floats(feet))
