"""Batched quaternions (w x y z) in torch: the few operations that a task needs."""

import torch
from torch import Tensor


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """(..., 3) vectors v turned by unit quaternions q (..., 4); leading dimensions broadcast."""
    w, axis = q[..., :1], q[..., 1:]
    axis, v = torch.broadcast_tensors(axis, v)
    t = 2.0 * torch.linalg.cross(axis, v)
    return v + w * t + torch.linalg.cross(axis, t)


def rotate_back(q: Tensor, v: Tensor) -> Tensor:
    """(..., 3) vectors v turned by the inverse of q: from world axes to those of the body whose pose is q."""
    return rotate(torch.cat([q[..., :1], -q[..., 1:]], -1), v)


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """(..., 4) Hamilton product: b first, then a."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    av, bv = torch.broadcast_tensors(av, bv)
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)


def about_z(angle: Tensor) -> Tensor:
    """(..., 4) rotations by (...) radians about z."""
    half = angle / 2
    zero = torch.zeros_like(half)
    return torch.stack([half.cos(), zero, zero, half.sin()], -1)


def from_vector(v: Tensor) -> Tensor:
    """(..., 4) of rotation vectors (..., 3) in radians."""
    angle = v.norm(dim=-1, keepdim=True)
    # sin(a/2)/a is torch.sinc(a / 2 pi) / 2, smooth at zero.
    return torch.cat([(angle / 2).cos(), v * torch.sinc(angle / (2 * torch.pi)) / 2], -1)


def heading_of(q: Tensor) -> Tensor:
    """(..., 2) unit vector on the level in which the body's x axis points: cosine and sine of its heading."""
    w, x, y, z = q.unbind(-1)
    ahead = torch.stack([1 - 2 * (y * y + z * z), 2 * (w * z + x * y)], -1)
    return ahead / ahead.norm(dim=-1, keepdim=True).clamp_min(1e-9)


def into_heading(ahead: Tensor, v: Tensor) -> Tensor:
    """(..., 2) level vectors v as seen along the unit vectors `ahead` (..., 2): x ahead, y to the left."""
    c, s = ahead.unbind(-1)
    x, y = v.unbind(-1)
    return torch.stack([c * x + s * y, c * y - s * x], -1)
