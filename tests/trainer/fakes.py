"""Doubles for unit tests of the task: an engine that holds whatever state a test writes, rays against boxes."""

import numpy as np
import torch

from trainer.physics.base import PhysicsConfig, empty_state
from trainer.robots import ROBOTS
from trainer.terrain import Box, Platform, Terrain


def quadruped():
    return ROBOTS["quadruped"]()


def course(length: float = 3.0, ground_fails: bool = True) -> Terrain:
    """Two platforms, 0.9 x 0.8 x 0.35 m, with nothing between them."""
    platforms = [Platform(np.array([x, 0.0, 0.0]), np.array([0.9, 0.8])) for x in (0.0, length)]
    boxes = []
    for platform in platforms:
        T = np.eye(4)
        T[:3, 3] = platform.centre - [0, 0, 0.175]
        boxes.append(Box(np.array([0.9, 0.8, 0.35]), T))
    none = np.zeros((0, 3))
    return Terrain("gap", tuple(boxes), none, none.astype(np.int32), *platforms, -0.35, ground_fails)


class BoxCaster:
    """Exact rays against a terrain's upright boxes and its ground plane."""

    def __init__(self, terrains) -> None:
        self.terrains = terrains

    def cast(self, origins, directions, terrain_ids, far):
        out = torch.full(origins.shape[:2], float(far))
        for i, terrain in enumerate(terrain_ids.tolist()):
            out[i] = self._one(self.terrains[terrain], origins[i], directions[i], far)
        return out

    def _one(self, terrain, origin, direction, far):
        inverse = 1.0 / torch.where(direction.abs() < 1e-9, torch.full_like(direction, 1e-9), direction)
        ground = (terrain.floor_z - origin[:, 2]) * inverse[:, 2]
        hits = [torch.where(ground > 0, ground, torch.full_like(ground, far))]
        for box in terrain.boxes:
            centre, half = torch.tensor(box.T[:3, 3]).float(), torch.tensor(box.size / 2).float()
            a, b = (centre - half - origin) * inverse, (centre + half - origin) * inverse
            enter, leave = torch.minimum(a, b).amax(-1), torch.maximum(a, b).amin(-1)
            hits.append(torch.where((enter <= leave) & (enter > 0), enter, torch.full_like(enter, far)))
        return torch.stack(hits).amin(0).clamp_max(far)


class FakePhysics:
    """Keeps a state of tensors. `motion(physics)`, if given, changes it at every step."""

    def __init__(self, robot, terrains, worlds: int = 4, motion=None, device: str = "cpu") -> None:
        self.robot, self.terrains, self.num_worlds, self.motion = robot, terrains, worlds, motion
        self.config = PhysicsConfig()
        self.device, self.policy_dt = torch.device(device), 0.02
        self.overflowed = self.solver_limited = 0
        self.state = empty_state(robot, worlds, self.device)
        self.targets = None
        self.terrain_ids = torch.zeros(worlds, dtype=torch.long, device=device)
        spread = [[0.15, 0.1], [0.15, -0.1], [-0.15, 0.1], [-0.15, -0.1]][: len(robot.feet)]
        self.spread, self.upright = torch.tensor(spread, device=device), torch.tensor([1.0, 0, 0, 0], device=device)
        self.params: list = []
        self.pushed: list = []
        self.reset(
            torch.arange(worlds, device=device),
            torch.tensor([0.0, 0.0, robot.standing_height], device=device).repeat(worlds, 1),
            self.upright.repeat(worlds, 1),
            torch.tensor(robot.default, device=device).float().repeat(worlds, 1),
            self.terrain_ids.clone(),
        )

    def step(self, targets):
        self.targets = targets
        if self.motion is not None:
            self.motion(self)
        return self.state

    def reset(self, ids, base_pos, base_quat, joint_pos, terrain_ids):
        s = self.state
        s.base_pos[ids], s.base_quat[ids], s.joint_pos[ids] = base_pos, base_quat, joint_pos
        s.torso_pos[ids], s.camera_pos[ids] = base_pos, base_pos
        s.torso_quat[ids], s.camera_quat[ids] = base_quat, base_quat
        depth = -float(np.mean(self.robot.soles[0][:, 2]))
        s.foot_pos[ids, :, :2] = base_pos[:, None, :2] + self.spread
        s.foot_pos[ids, :, 2] = (base_pos[:, 2] - self.robot.standing_height + depth)[:, None]
        s.foot_quat[ids] = self.upright
        for name in ("base_lin_vel", "base_ang_vel", "joint_vel", "joint_acc", "joint_torque", "foot_lin_vel"):
            getattr(s, name).index_fill_(0, ids, 0.0)
        s.foot_force.index_fill_(0, ids, 20.0)
        for name in ("ground_contact", "other_contact", "diverged"):
            getattr(s, name).index_fill_(0, ids, False)
        self.terrain_ids[ids] = terrain_ids

    def set_velocity(self, ids, base_lin_vel, base_ang_vel):
        self.pushed.append((ids, base_lin_vel))

    def set_params(self, ids, params):
        self.params.append((ids, params))


def walk(velocity: float):
    """A motion: every body moves ahead at this speed, m/s."""

    def move(physics) -> None:
        s = physics.state
        for name in ("base_pos", "torso_pos", "camera_pos"):
            getattr(s, name)[:, 0] += velocity * physics.policy_dt
        s.foot_pos[..., 0] += velocity * physics.policy_dt
        s.base_lin_vel[:, 0] = velocity

    return move
