"""Poses from matches: what the network says of corresponding places, and no weights.

A network that regresses poses has to learn geometry from examples. What it can learn quickly is which places of two
pictures are the same; the rest is solved in closed form: the rigid motion between two sets of points (Horn 1987), and
one pose a view along the pairs that match best. Everything is made of operations that ONNX has.
"""

import torch
from torch import Tensor

REWEIGHTED = 3
"""Rounds in which pairs that do not fit lose weight (Geman and McClure 1985)."""
SQUARED = 10
"""Squarings of the 4 x 4 matrix whose largest eigenvector is wanted: 2^10 steps of the power method."""
TINY = 1e-9
SURE = 1e9
"""Strength of the root: above every pair's."""


def solve(points: Tensor, matches: Tensor) -> tuple[Tensor, Tensor]:
    """Poses of all views in the frame of the view that matches the others best.

    Args:
        points: (B, V, N, 3) of N places in each camera's frame.
        matches: (B, V, V, N, N) probability that place n of view i is place m of view j; what is missing to one is
            the probability that view j does not show it.

    Returns:
        R: (B, V, 3, 3) camera to world.
        t: (B, V, 3).
    """
    R, t, strength = pairs(points, matches)
    return _along_best_paths(R, t, strength)


def pairs(points: Tensor, matches: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For all ordered pairs: R (B, V, V, 3, 3) and t (B, V, V, 3) of camera j in camera i, and the weight of what
    agrees (B, V, V).

    Each place votes with its expected partner, weighted by sum p^2: one for a sure match, nothing for a place that is
    lost or could be anywhere.
    """
    there = torch.einsum("bijnm,bjmc->bijnc", matches, points) / matches.sum(-1, keepdim=True).clamp(min=TINY)
    sure = (matches * matches).sum(-1)
    here = points[:, :, None].expand_as(there)
    x = torch.cat([here, there.transpose(1, 2)], 3)
    y = torch.cat([there, here.transpose(1, 2)], 3)
    first = torch.cat([sure, sure.transpose(1, 2)], 3)
    size = x[..., 2].abs().clamp(min=TINY)  # a metre is much nearby and little far away
    weight = first / size
    R, t = _motion(x, y, weight)
    for _ in range(REWEIGHTED):
        off = (x - (y @ R.transpose(-1, -2) + t[..., None, :])).square().sum(-1).sqrt() / size
        usual = (first * off).sum(-1, keepdim=True) / first.sum(-1, keepdim=True).clamp(min=TINY)
        fits = 1 / (1 + (off / usual.clamp(min=TINY)).square()).square()
        weight = first * fits / size
        R, t = _motion(x, y, weight)
    return R, t, (first * fits).sum(-1)


def _motion(x: Tensor, y: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """R, t of the least squares of x = R y + t over (..., N, 3) with weights (..., N), by Horn's quaternions."""
    total = weight.sum(-1).clamp(min=TINY)[..., None]
    mx, my = (weight[..., None] * x).sum(-2) / total, (weight[..., None] * y).sum(-2) / total
    S = ((y - my[..., None, :]) * weight[..., None]).transpose(-1, -2) @ (x - mx[..., None, :])
    S = S / S.square().sum((-1, -2), keepdim=True).sqrt().clamp(min=TINY)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([S[..., i, j] for j in range(3)] for i in range(3))
    rows = (
        (xx + yy + zz, yz - zy, zx - xz, xy - yx),
        (yz - zy, xx - yy - zz, xy + yx, zx + xz),
        (zx - xz, xy + yx, yy - xx - zz, yz + zy),
        (xy - yx, zx + xz, yz + zy, zz - xx - yy),
    )
    # No eigenvalue is below -2: with 2 added, the largest is the largest in size. A little of the identity's own
    # quaternion decides where nothing matches.
    M = torch.stack([torch.stack(row, -1) for row in rows], -2) + 2 * torch.eye(4, device=x.device, dtype=x.dtype)
    still = torch.zeros(4, 4, device=x.device, dtype=x.dtype)
    still[0, 0] = 1e-5
    M = M + still
    for _ in range(SQUARED):
        M = M @ M
        M = M / M.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    # Every column is a multiple of the eigenvector: the longest has the least rounding.
    size = M.diagonal(dim1=-2, dim2=-1)
    q = (M * (size == size.amax(-1, keepdim=True))[..., None, :]).sum(-1)
    R = matrix(q / q.square().sum(-1, keepdim=True).sqrt().clamp(min=TINY))
    return R, mx - (R @ my[..., None])[..., 0]


def matrix(q: Tensor) -> Tensor:
    """(..., 3, 3) rotation of a unit quaternion (..., 4), w first."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


LONGEST = 7
"""Pairs in a path: with 8 views there is no longer one."""


def _along_best_paths(R: Tensor, t: Tensor, strength: Tensor) -> tuple[Tensor, Tensor]:
    """Every view's pose by the path of pairs from the root whose weakest pair is strongest (Bellman and Ford)."""
    number = torch.ones_like(strength[:1, 0]).cumsum(-1)[0].round() - 1  # arange, for any number of views in the graph
    strength = strength * (number[:, None] != number).to(strength.dtype)
    root = (number == strength.sum(-1).argmax(-1)[:, None]).to(strength.dtype)  # (B, V), one of them 1
    here, there = root[:, :, None, None], 1 - root[:, :, None, None]
    R_world = here * torch.eye(3, device=R.device, dtype=R.dtype) + there * torch.einsum("bi,bijkl->bjkl", root, R)
    t_world = there[..., 0] * torch.einsum("bi,bijk->bjk", root, t)
    reached = torch.maximum(root * SURE, torch.einsum("bi,bij->bj", root, strength))
    for _ in range(LONGEST):
        through = torch.minimum(reached[:, :, None], strength)  # (B, from, to)
        via = (number[:, None] == through.argmax(1)[:, None]).to(R.dtype)  # (B, from, to), one of each column 1
        better = (through.amax(1) > reached).to(R.dtype)[..., None]
        R_from = torch.einsum("bij,bikl->bjkl", via, R_world)
        R_step, t_step = torch.einsum("bij,bijkl->bjkl", via, R), torch.einsum("bij,bijk->bjk", via, t)
        t_new = (R_from @ t_step[..., None])[..., 0] + torch.einsum("bij,bik->bjk", via, t_world)
        R_world = better[..., None] * (R_from @ R_step) + (1 - better[..., None]) * R_world
        t_world = better * t_new + (1 - better) * t_world
        reached = torch.maximum(reached, through.amax(1))
    return R_world, t_world
