"""Starts of episodes: standing on the start platform or somewhere on the course, roughly facing the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from trainer.rays import RayCaster, fall
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.config import ResetConfig
from trainer.tasks.parkour.draw import rand, symmetric
from trainer.tasks.rotations import about_z
from trainer.terrain import Terrain
from trainer.terrain.course import PLATFORM

_HIGH = 2.0
"""Metres above the start platform from which rays look down for places to stand."""
_UNEVEN, _STEP = 0.04, 0.08
"""Metres by which the ground under one sole, and under the soles together, may differ where a robot is put."""
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
    floor_z: Tensor
    """(T,) m, where the ground collides."""

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
            floor_z=floats(np.array([t.floor_z for t in terrains])),
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


@dataclass(frozen=True)
class Stances:
    """Places on each course where a robot in its default pose has both soles supported; rows are terrains."""

    pose: Tensor
    """(T, M, 4): x, y and z in m of the highest sole point, yaw in rad; the first `count` of a row are valid."""
    count: Tensor
    """(T,)."""

    @staticmethod
    def find(course: Course, soles: Tensor, caster: RayCaster, seed: int, tries: int = 128) -> Stances:
        """Try random places on every course.

        Args:
            soles: (F, P, 3) m, points on the soles of a robot in its default pose at the origin, facing x.
        """
        device, terrains = soles.device, len(course.start)
        generator = torch.Generator(device).manual_seed(seed)
        drawn = torch.rand(terrains, tries, 3, generator=generator, device=device)
        half = 0.5 * PLATFORM[0]
        along = half + drawn[..., 0] * (course.length[:, None] - 2 * half)
        aside, yaw = 0.3 * (drawn[..., 1] - 0.5), course.yaw[:, None] + 0.4 * (drawn[..., 2] - 0.5)
        cos, sin = course.yaw.cos()[:, None], course.yaw.sin()[:, None]
        xy = course.start[:, None, :2] + torch.stack([along * cos - aside * sin, along * sin + aside * cos], -1)
        flat = soles.reshape(-1, 3)[:, :2]
        c, s = yaw.cos()[..., None], yaw.sin()[..., None]
        points = torch.stack([c * flat[:, 0] - s * flat[:, 1], s * flat[:, 0] + c * flat[:, 1]], -1) + xy[:, :, None]
        above = torch.full_like(points[..., :1], _HIGH)
        origins = torch.cat([points, above], -1).reshape(terrains, -1, 3)
        ids = torch.arange(terrains, device=device)
        z = _HIGH - fall(caster, origins, ids, 2 * _HIGH + 2.0).reshape(terrains, tries, *soles.shape[:2])
        highest = z.amax(-1)
        level = (highest - z.amin(-1)).amax(-1) < _UNEVEN
        together = highest.amax(-1) - highest.amin(-1) < _STEP
        off_floor = highest.amin(-1) > course.floor_z[:, None] + _STEP
        good = level & together & off_floor
        order = good.int().argsort(dim=1, descending=True, stable=True)
        pose = torch.cat([xy, highest.amax(-1)[..., None], yaw[..., None]], -1)
        return Stances(torch.gather(pose, 1, order[..., None].expand_as(pose)), good.sum(1))


def poses(
    terrain_ids: Tensor,
    course: Course,
    body: Body,
    config: ResetConfig,
    generator: torch.Generator,
    stances: Stances | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Where new episodes on terrains (K,) begin.

    Returns:
        (K, 3) base position, (K, 4) base quaternion, (K, J) joints, (K,) bool whether on the course instead of at its
        start.
    """
    count = len(terrain_ids)
    position = course.start[terrain_ids].clone()
    position[:, :2] += symmetric(config.position, (count, 2), generator)
    yaw = course.yaw[terrain_ids] + symmetric(config.yaw, (count,), generator)
    along = torch.zeros(count, dtype=torch.bool, device=position.device)
    if stances is not None:
        dice = rand((count, 2), generator)
        found = stances.count[terrain_ids]
        along = (dice[:, 0] < config.along) & (found > 0)
        place = stances.pose[terrain_ids, (dice[:, 1] * found).long()]
        position = torch.where(along[:, None], place[:, :3], position)
        yaw = torch.where(along, place[:, 3], yaw)
    position[:, 2] += body.standing_height + _DROP
    joints = body.default + symmetric(config.joints, (count, len(body.default)), generator)
    return position, about_z(yaw), torch.minimum(torch.maximum(joints, body.lower), body.upper), along
