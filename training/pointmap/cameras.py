"""Cameras: smooth paths that look at one place, at the height of a robot or of a hand, and their intrinsics."""

import math

import torch
from torch import Tensor

from training.pointmap.draw import Draw

D435_FOCAL = 0.961
"""Focal length over width of a D435i's colour camera at 640x480."""
ASKEW = 0.2
"""Share of scenes whose camera is held askew, as a hand does that reaches under or around something."""
LEVEL = 0.25
"""Share of scenes whose camera looks along the floor from a few hand's breadths above it, as on a small quadruped."""
AROUND = 0.2
"""Share of scenes in which the camera looks around, so that its first and last views share little."""


def intrinsics(draw: Draw, scenes: int, size: tuple[int, int]) -> Tensor:
    """(B, 3, 3) pixels, the centre of the first pixel at (0, 0): D435-like ones, phones, wide lenses.

    One in seven has pixels that are not square: the runner stretches every picture onto one grid, so a portrait
    picture becomes a stretched one.
    """
    h, w = size
    focal = draw.log_uniform(0.5, 1.25, scenes)
    focal = torch.where(draw.chance(0.5, scenes), D435_FOCAL * draw.log_uniform(0.95, 1.05, scenes), focal)
    stretch = torch.where(draw.chance(0.15, scenes), draw.log_uniform(0.5, 1.8, scenes), 1.0)
    K = torch.zeros(scenes, 3, 3, device=draw.device)
    # The grid is 4:3. Another shape of picture means another ratio of the focal lengths on it.
    K[:, 0, 0] = focal * w / stretch.clamp(max=1).sqrt()
    K[:, 1, 1] = focal * w * stretch * (h / w * 4 / 3)
    K[:, 0, 2] = (w - 1) / 2 + w * draw.normal(0.015, scenes)
    K[:, 1, 2] = (h - 1) / 2 + h * draw.normal(0.015, scenes)
    K[:, 2, 2] = 1
    return K


def path(draw: Draw, scenes: int, views: int) -> tuple[Tensor, Tensor]:
    """(B, V, 4, 4) camera to world, OpenCV axes, world z up, and (B, V, 4, 4) the same a short time later.

    An eye moves along a bent line; the point looked at moves with it in part, and sways.
    """
    b = scenes
    hand = draw.chance(0.6, b)
    height = torch.where(hand, draw.uniform(0.8, 1.8, b), draw.uniform(0.3, 1.1, b))
    angle, far = draw.uniform(-math.pi, math.pi, b), draw.log_uniform(0.5, 3.0, b)
    level = draw.chance(LEVEL, b)
    height = torch.where(level, draw.uniform(0.12, 0.6, b), height)
    aim = torch.where(level, height + far * draw.normal(0.12, b), draw.uniform(0.0, 0.5, b))
    target = torch.stack([draw.normal(0.9, b), draw.normal(0.35, b), aim], -1)
    eye = torch.stack([far * angle.cos(), far * angle.sin(), height], -1) + target * target.new_tensor([1, 1, 0])
    turn = angle + math.pi / 2 * draw.below(2, b) + draw.normal(0.5, b)  # across the line of sight, or along it
    # From one view to the next 6 to 70 cm: neighbours in a walk, and every fourth of them.
    length = draw.log_uniform(0.06, 0.7, b) * max(views - 1, 1)
    step = torch.stack([turn.cos(), turn.sin(), draw.normal(0.15, b)], -1) * length[:, None]
    bend = draw.normal(0.2, b, 3) * length[:, None]
    drift = draw.uniform(0.0, 1.2, b, 1) * step * step.new_tensor([1, 1, 0.2]) + draw.normal(0.3, b, 3)
    sweep = far[:, None] * draw.normal(1.0, b, 3) * step.new_tensor([1, 1, 0.1])
    drift = drift + torch.where(draw.chance(AROUND, b, 1), sweep, 0.0)
    s = torch.linspace(-0.5, 0.5, views, device=draw.device) + draw.uniform(-0.25, 0.25, b, views) / views
    shake = draw.log_uniform(0.003, 0.05, b, 1, 1) * draw.normal(1, b, views, 7)
    askew = draw.normal(0.5, b, 1) + draw.normal(0.25, b, views)
    roll = draw.normal(0.06, b, 1) + shake[..., 6] + torch.where(draw.chance(ASKEW, b, 1), askew, 0.0)

    def at(time: Tensor, shaken: Tensor) -> Tensor:
        u = time[..., None]
        where = eye[:, None] + u * step[:, None] + (u**2) * bend[:, None] + shaken[..., :3]
        where = torch.cat([where[..., :2], where[..., 2:].clamp(min=0.1)], -1)
        return look_at(where, target[:, None] + u * drift[:, None] + 2 * shaken[..., 3:6], roll)

    # What the hand does while the shutter is open: a few per cent of the way, and some of the shake.
    later = at(s + draw.uniform(0, 0.06, b, 1) / views, shake + draw.log_uniform(0.0002, 0.008, b, 1, 1))
    return at(s, shake), later


def look_at(eye: Tensor, target: Tensor, roll: Tensor) -> Tensor:
    """(..., 4, 4) poses of cameras at `eye` (..., 3) that look at `target`, turned by `roll` (...) about their axis."""
    z = torch.nn.functional.normalize(target - eye, dim=-1)
    up = z.new_tensor([0.0, 0.0, 1.0]).expand_as(z)
    x = torch.nn.functional.normalize(torch.linalg.cross(z, up) + 1e-6, dim=-1)
    y = torch.linalg.cross(z, x)
    c, s = roll.cos()[..., None], roll.sin()[..., None]
    T = torch.zeros(*eye.shape[:-1], 4, 4, device=eye.device)
    T[..., :3, 0], T[..., :3, 1], T[..., :3, 2], T[..., :3, 3] = c * x + s * y, c * y - s * x, z, eye
    T[..., 3, 3] = 1
    return T


def rays(K: Tensor, size: tuple[int, int], shift: Tensor | None = None) -> Tensor:
    """(..., H, W, 3) directions with z = 1 of pixel centres, `shift` (..., 2) pixels to the right and down."""
    h, w = size
    v, u = torch.meshgrid(
        torch.arange(h, dtype=torch.float32, device=K.device), torch.arange(w, dtype=torch.float32, device=K.device),
        indexing="ij",
    )  # fmt: skip
    if shift is not None:
        u, v = u + shift[..., 0, None, None], v + shift[..., 1, None, None]
    x = (u - K[..., 0, 2, None, None]) / K[..., 0, 0, None, None]
    y = (v - K[..., 1, 2, None, None]) / K[..., 1, 1, None, None]
    return torch.stack([x, y, torch.ones_like(x)], -1)


def inverse(T: Tensor) -> Tensor:
    """Inverse of rigid motions (..., 4, 4)."""
    R = T[..., :3, :3].transpose(-1, -2)
    out = torch.zeros_like(T)
    out[..., :3, :3] = R
    out[..., :3, 3] = -(R @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1
    return out
