"""Where an episode begins: standing on the start platform, roughly facing the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import ResetConfig
from trainer.tasks.parkour.draw import symmetric
from trainer.tasks.rotations import about_z
from trainer.terrain import Terrain

_DROP = 0.02
"""Metres above the platform at which the soles of the default pose begin: other poses reach a little lower."""


@dataclass(frozen=True)
class Course:
    """Start and goal of every terrain, float32 on the device; rows are terrains."""

    start: Tensor
    """(T, 3) m, centre of the start platform's top."""
    goal: Tensor
    """(T, 3)."""
    goal_half: Tensor
    """(T, 2) m, half the goal platform's extent along its own axes."""
    goal_yaw: Tensor
    """(T,) rad, direction of the goal platform's own x."""
    yaw: Tensor
    """(T,) rad, direction from start to goal."""
    length: Tensor
    """(T,) m between the centres, on the level."""
    ground_fails: Tensor
    """(T,) bool."""

    @staticmethod
    def of(terrains: Sequence[Terrain], device: torch.device) -> Course:
        start = np.array([t.start.centre for t in terrains], np.float32)
        goal = np.array([t.goal.centre for t in terrains], np.float32)
        half = np.array([t.goal.size / 2 for t in terrains], np.float32)
        away = (goal - start)[:, :2]

        def floats(values: np.ndarray) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        return Course(
            start=floats(start),
            goal=floats(goal),
            goal_half=floats(half),
            goal_yaw=floats(np.array([t.goal.yaw for t in terrains])),
            yaw=floats(np.arctan2(away[:, 1], away[:, 0])),
            length=floats(np.linalg.norm(away, axis=1)),
            ground_fails=torch.tensor([t.ground_fails for t in terrains], device=device),
        )

    def covered(self, xy: Tensor, terrain_ids: Tensor) -> Tensor:
        """(N,) share of the way from start to goal that points (N, 2) have behind them, 0 to 1."""
        start, yaw = self.start[terrain_ids, :2], self.yaw[terrain_ids]
        along = xy - start
        forward = along[:, 0] * yaw.cos() + along[:, 1] * yaw.sin()
        return (forward / self.length[terrain_ids].clamp_min(1e-6)).clamp(0.0, 1.0)

    def on_goal(self, base_xy: Tensor, feet_xy: Tensor, terrain_ids: Tensor) -> Tensor:
        """(N,) bool: base (N, 2) and all feet (N, F, 2) are over the goal platform."""
        points = torch.cat([base_xy[:, None], feet_xy], 1)
        x, y = (points - self.goal[terrain_ids, None, :2]).unbind(-1)
        cos, sin = self.goal_yaw[terrain_ids, None].cos(), self.goal_yaw[terrain_ids, None].sin()
        off = torch.stack([x * cos + y * sin, y * cos - x * sin], -1).abs()
        return (off <= self.goal_half[terrain_ids][:, None]).all(-1).all(-1)


def poses(
    terrain_ids: Tensor, course: Course, body: Body, config: ResetConfig, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """((K, 3) base position, (K, 4) base quaternion, (K, J) joints) of new episodes on terrains (K,)."""
    count = len(terrain_ids)
    position = course.start[terrain_ids].clone()
    position[:, :2] += symmetric(config.position, (count, 2), generator)
    position[:, 2] += body.standing_height + _DROP
    yaw = course.yaw[terrain_ids] + symmetric(config.yaw, (count,), generator)
    joints = body.default + symmetric(config.joints, (count, len(body.default)), generator)
    return position, about_z(yaw), torch.minimum(torch.maximum(joints, body.lower), body.upper)
