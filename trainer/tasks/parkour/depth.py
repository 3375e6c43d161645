"""The depth camera: which rays stand for the policy's pixels, what spoils them, and the strided window of images.

The real camera delivers 480 x 270; the robot keeps the nearest pixel of a 64 x 36 grid and of that the 32 x 18 pixels
at the bottom centre. Only the rays of those are cast, each through the centre of the full image's pixel that is kept.
"""

from math import radians, tan

import numpy as np
import torch
from torch import Tensor

from trainer.physics import State
from trainer.rays import RayCaster
from trainer.robots import DepthMount
from trainer.tasks.parkour.config import DepthConfig
from trainer.tasks.parkour.draw import rand, randint, randn, symmetric
from trainer.tasks.rotations import from_vector, multiply, rotate


def kept_pixels(mount: DepthMount) -> tuple[np.ndarray, np.ndarray]:
    """((h,) rows, (w,) columns) of the full image that the policy sees."""
    (full_w, full_h), (small_w, small_h), (w, h) = mount.full, mount.small, mount.crop
    left, top = (small_w - w) // 2, small_h - h
    rows = ((np.arange(top, top + h) + 0.5) * full_h / small_h).astype(int)
    columns = ((np.arange(left, left + w) + 0.5) * full_w / small_w).astype(int)
    return rows, columns


def crop(full: np.ndarray, mount: DepthMount) -> np.ndarray:
    """(..., h, w) what the policy sees of a full image (..., H, W): the same on the robot as in simulation."""
    rows, columns = kept_pixels(mount)
    return full[..., rows[:, None], columns[None, :]]


def normalise(depth: Tensor, config: DepthConfig) -> Tensor:
    """Depth along the optical axis in metres to 0..1; what is not measured (0 or not finite) becomes 1."""
    unit = ((depth - config.near) / (config.far - config.near)).clamp(0.0, 1.0)
    return torch.where(torch.isfinite(depth) & (depth > 0), unit, torch.ones_like(unit))


def rays(mount: DepthMount) -> np.ndarray:
    """(h * w, 3) unit directions in the mount's frame (x optical axis, y left, z up), row by row from the top."""
    rows, columns = kept_pixels(mount)
    width, height = mount.full
    focal = height / 2 / tan(radians(mount.fovy_deg) / 2)
    left = (width / 2 - (columns + 0.5)) / focal
    up = (height / 2 - (rows + 0.5)) / focal
    grid = np.stack(np.broadcast_arrays(1.0, left[None, :], up[:, None]), -1).reshape(-1, 3)
    return grid / np.linalg.norm(grid, axis=-1, keepdims=True)


class DepthCamera:
    """Images of all worlds, spoiled as the real camera's are."""

    def __init__(
        self, mount: DepthMount, config: DepthConfig, caster: RayCaster, worlds: int, device: torch.device
    ) -> None:
        self.config, self.caster = config, caster
        self.width, self.height = mount.crop
        directions = rays(mount)
        self.rays = torch.as_tensor(directions, dtype=torch.float32, device=device)
        self.reach = config.far / float(directions[:, 0].min())
        """Metres along the ray of a corner at which its depth is `far`."""
        self.nominal_pos = torch.as_tensor(mount.pos, dtype=torch.float32, device=device)
        self.nominal_quat = torch.as_tensor(mount.quat, dtype=torch.float32, device=device)
        self.pos = self.nominal_pos.repeat(worlds, 1)
        self.quat = self.nominal_quat.repeat(worlds, 1)

    def reset(self, ids: Tensor, generator: torch.Generator) -> None:
        """A new misplacement of the mount for worlds (K,)."""
        c = self.config
        self.pos[ids] = self.nominal_pos + symmetric(c.mount_position, (len(ids), 3), generator)
        turn = from_vector(symmetric(c.mount_rotation, (len(ids), 3), generator))
        self.quat[ids] = multiply(self.nominal_quat.expand(len(ids), 4), turn)

    def render(self, state: State, terrain_ids: Tensor, ids: Tensor | None, generator: torch.Generator) -> Tensor:
        """(N, h, w) images in 0..1 of all worlds, or (K, h, w) of worlds `ids`."""
        depth = self._spoil(self.measure(state, terrain_ids, ids), generator)
        return normalise(depth, self.config).nan_to_num(1.0).view(-1, self.height, self.width)

    def measure(self, state: State, terrain_ids: Tensor, ids: Tensor | None = None) -> Tensor:
        """(N, h * w) metres along the optical axis of all worlds, or (K, h * w) of worlds `ids`, unspoiled."""
        body_pos, body_quat, pos, quat = state.camera_pos, state.camera_quat, self.pos, self.quat
        if ids is not None:
            body_pos, body_quat, pos, quat = body_pos[ids], body_quat[ids], pos[ids], quat[ids]
            terrain_ids = terrain_ids[ids]
        origin = body_pos + rotate(body_quat, pos)
        direction = rotate(multiply(body_quat, quat)[:, None], self.rays)
        along = self.caster.cast(origin[:, None].expand_as(direction), direction, terrain_ids, self.reach)
        return along * self.rays[:, 0]

    def _spoil(self, depth: Tensor, generator: torch.Generator) -> Tensor:
        c = self.config
        if c.noise > 0:
            depth = (depth + c.noise * depth.square() * randn(tuple(depth.shape), generator)).clamp_min(1e-3)
        if c.dropout > 0:
            lost = rand(tuple(depth.shape), generator) < c.dropout
            depth = torch.where(lost, torch.zeros_like(depth), depth)
        return depth


class DepthWindow:
    """Images stored once in a ring and gathered when the window I_(t - late - k * stride), k = 0..m-1, is requested."""

    def __init__(self, config: DepthConfig, shape: tuple[int, int], worlds: int, device: torch.device) -> None:
        self.length = (config.frames - 1) * config.stride + 1 + config.latency[1]
        self.ring = torch.ones(worlds, self.length, *shape, device=device)
        self.back = torch.arange(config.frames, device=device) * config.stride
        self.late = torch.zeros(worlds, dtype=torch.long, device=device)
        self.latency = config.latency
        self.head = torch.zeros(1, dtype=torch.long, device=device)
        self._worlds = torch.arange(worlds, device=device)

    def push(self, images: Tensor) -> None:
        """Append the newest image (N, h, w) of every world."""
        self.head.add_(1).remainder_(self.length)
        self.ring.index_copy_(1, self.head, images[:, None])

    def restart(self, ids: Tensor, images: Tensor, generator: torch.Generator) -> None:
        """Worlds `ids` begin with (K, h, w) as if they had always seen it, with a new latency."""
        self.ring[ids] = images[:, None]
        low, high = self.latency
        self.late[ids] = randint(low, high + 1, len(ids), generator)

    def window(self, ids: Tensor | None = None) -> Tensor:
        """(N, m, h, w), newest first; or (K, m, h, w) of worlds `ids`."""
        rows = self._worlds if ids is None else ids
        at = (self.head - self.late[rows, None] - self.back) % self.length
        return self.ring[rows[:, None], at]
