"""Depth and poses from matched rays: two rays that meet are a depth. No weights.

By colour alone the network guesses depth view by view; its matches say more. Poses, and for every view a smooth
correction of log z, are adjusted together (Triggs et al. 2000) until matched places meet in the picture and in depth;
the correction is held by how wrong the network itself expects to be, and where matches tell depth, less error is
expected afterwards. Everything is made of operations that ONNX has: the linear systems are solved by conjugate
gradients, a fixed number of steps each.

The numbers below were set on generated scenes (training/pointmap/README.md); none is sharp.
"""

import math

import torch
from torch import Tensor

WAVES = 6
"""Of the cosines that make a correction, those whose half waves over height and width are together fewer."""
ROUGH = 1.5
"""A correction of k half waves has a standard deviation of 1 / (1 + k^ROUGH) of the expected error: measured."""
ASIDE = 0.012
"""Tangent: error of a sure match, a quarter of a patch."""
ALONG = 0.08
"""Relative difference of two views' depths of the same place that is usual."""
DOUBT = 3.0
"""Times the usual error at which a match has lost three quarters of its weight (Geman and McClure 1985)."""
ROUNDS = 6
"""Of Gauss-Newton."""
GRADIENTS = 25
"""Steps of conjugate gradients a round."""
NEAREST = 0.05
"""A point nearer to a camera's plane, or behind it, says nothing."""
FINE = 0.1
"""Share of the variance of a depth's error that no match tells: what changes within a patch. Measured."""
TINY = 1e-12


def adjust(
    rays: Tensor, log_z: Tensor, expected: Tensor, matches: Tensor, R: Tensor, t: Tensor, grid: tuple[int, int]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Corrections and poses, and how well the matches tell them.

    Args:
        rays: (B, V, N, 2) x / z and y / z of N = rows x columns places of each view.
        log_z: (B, V, N).
        expected: (B, V) relative error of a view's depth that is expected.
        matches: (B, V, V, N, N) as in `poses.solve`.
        R, t: (B, V, 3, 3) and (B, V, 3), where to begin.
        grid: rows and columns.

    Returns:
        weights of `waves` (B, V, K), to be added to log z; R; t; (B, V, N) the precision with which the matches of a
        place tell its log z, times `expected` squared.
    """
    rows, columns = grid
    r, c = (x.to(rays) for x in (_centres(rows), _centres(columns)))
    here = torch.stack([r[:, None].expand(rows, columns), c.expand(rows, columns)], -1).flatten(0, 1)
    own = (waves(here) * expected[..., None, None])[:, :, None]  # (B, V, 1, N, K)
    # Where the partner is: the mean over squared probabilities, which is near the best patch.
    sharp = matches * matches
    sure = sharp.sum(-1)
    told = torch.cat([rays, log_z[..., None], here.expand_as(rays)], -1)
    there = torch.einsum("bijnm,bjmc->bijnc", sharp, told) / sure.clamp(min=TINY)[..., None]
    aim, far = there[..., :2], there[..., 2]
    theirs = waves(there[..., 3:]) * expected[:, None, :, None, None]
    size = own.shape[-1]
    number = (0 * expected[:1] + 1).cumsum(-1)[0].round()  # arange, for any number of views in the graph
    same = (number[:, None] == number).to(rays.dtype)
    sure = sure * (1 - same)[:, :, None]
    n = 6 + size
    one = torch.eye(n).to(rays)
    held = one * rays.new_tensor([1e-3] * 6 + [1.0] * size)  # poses are as good as free
    a = 0 * own[:, :, 0, 0]
    for _ in range(ROUNDS):
        # Everything in one product: J' J, and behind it J' times what is off.
        J = _linear(rays, log_z, own, theirs, aim, far, a, R, t, sure)
        told = J[..., 6].square().sum((2, 4))  # the first cosine is a constant: one expected error of log z
        J = J.flatten(3, 4)
        both = J.transpose(-1, -2)[..., :-1, :] @ J
        H, g = both[..., :-1], both[..., -1]
        D = H[..., :n, :n].sum(2) + H[..., n:, n:].sum(1) + held
        H = H[..., :n, n:] + H[..., n:, :n].transpose(1, 2) + same[:, :, None, None] * D[:, :, None]
        g = g[..., :n].sum(2) + g[..., n:].sum(1) + torch.cat([0 * a[..., :6], a], -1)
        scale = (D * one).sum(-1).clamp(min=TINY).rsqrt()  # a system with ones on its diagonal
        scaled = H * scale[:, :, None, :, None] * scale[:, None, :, None]
        step = -_descended(scaled, (scale * g)[..., None], GRADIENTS)[..., 0] * scale
        a = a + step[..., 6:]
        t = t + (R @ step[..., 3:6, None])[..., 0]
        half = _cross(step[..., :3] / 2)  # of the quaternion with real part 1
        R = R + R @ (half + half @ half) * (2 / (1 + (step[..., :3] / 2).square().sum(-1)))[..., None, None]
    return a * expected[..., None], R, t, told


def left(told: Tensor) -> Tensor:
    """What an expected error is multiplied by where matches tell log z with `told` times the precision that it had.

    Precisions add, but for the share of the error that no match can tell.
    """
    return (FINE + (1 - FINE) / (1 + told)).sqrt()


def correction(weights: Tensor, h: int, w: int) -> Tensor:
    """(B, V, H, W) what `adjust`'s weights add to log z."""
    r, c = _centres(h).to(weights), _centres(w).to(weights)
    every = waves(torch.stack([r[:, None].expand(h, w), c.expand(h, w)], -1))
    return torch.einsum("hwk,bvk->bvhw", every, weights)


def _centres(count: int) -> Tensor:
    return (torch.arange(count, dtype=torch.float32) + 0.5) / count


def waves(at: Tensor) -> Tensor:
    """(..., K) cosines at places (..., 2), down and across, 0..1, each as large as is usual."""
    pairs = [(i, k) for i in range(WAVES) for k in range(WAVES - i)]
    down, across = (math.pi * at.new_tensor([float(p[x]) for p in pairs]) for x in (0, 1))
    usual = at.new_tensor([1 / (1 + math.hypot(*p) ** ROUGH) for p in pairs])
    return torch.cos(at[..., :1] * down) * torch.cos(at[..., 1:] * across) * usual


def _linear(
    rays: Tensor, log_z: Tensor, own: Tensor, theirs: Tensor, aim: Tensor, far: Tensor, a: Tensor, R: Tensor, t: Tensor,
    sure: Tensor,
) -> Tensor:  # fmt: skip
    """(B, V, V, N, 3, 2 (6 + K) + 1) of places of view i in j, across, down and along, in usual errors: derivatives
    by the turn, motion and correction of i, then of j; last, how far they are off. All times the root of the weight."""
    z = (log_z + (own[:, :, 0] * a[:, :, None]).sum(-1)).exp()[..., None]
    X = torch.cat([rays * z, z], -1)[:, :, None]
    turn = R.transpose(-1, -2)[:, None] @ R[:, :, None]  # R_j' R_i
    apart = (R.transpose(-1, -2)[:, None] @ (t[:, :, None] - t[:, None])[..., None])[..., 0]
    turned = X @ turn.transpose(-1, -2)
    y = turned + apart[:, :, :, None]
    z = y[..., 2].clamp(min=NEAREST)
    x, inverse = y[..., :2] / z[..., None], 1 / z[..., None]
    log_there = far + (theirs * a[:, None, :, None]).sum(-1)
    usual = rays.new_tensor([ASIDE, ASIDE, ALONG])
    off = torch.cat([x - aim, (z.log() - log_there)[..., None]], -1) / usual
    # The derivatives by y of x / z, y / z and log z.
    ahead = rays.new_tensor([0.0, 0.0, 1.0])
    flat = torch.eye(3).to(rays) - torch.cat([x, 0 * inverse], -1)[..., None] * ahead
    by_y = flat * inverse[..., None] / usual[:, None]
    by_X = by_y @ turn[:, :, :, None]
    J = torch.cat([
        -by_X @ _cross(X), by_X, (by_y @ turned[..., None]) * own[..., None, :],
        by_y @ _cross(y), -by_y, -(ahead / ALONG)[:, None] * theirs[..., None, :], off[..., None],
    ], -1)  # fmt: skip
    square = (off / DOUBT).square()
    # Roots of weights: 1 / (1 + x^2)^2 is the weight.
    fits = sure.sqrt()[..., None] / (1 + square[..., :2].sum(-1, keepdim=True)) * (y[..., 2:] > NEAREST).to(y.dtype)
    return J * torch.cat([fits, fits, fits / (1 + square[..., 2:])], -1)[..., None]


def _cross(a: Tensor) -> Tensor:
    """(..., 3, 3) that takes b to a x b."""
    rows = [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]]
    return (a @ a.new_tensor([[float(v) for v in row] for row in rows])).unflatten(-1, (3, 3))


@torch.jit.script
def _descended(A: Tensor, b: Tensor, steps: int) -> Tensor:
    """x of A x = b by conjugate gradients, A (B, V, V, n, n) positive, b (B, V, n, 1).

    Scripted, so that it is a loop in the exported graph: onnxruntime takes half a minute to load it written out.
    """
    x, r, p = 0 * b, b, b
    size = (r * r).sum((1, 2), keepdim=True)
    for _ in range(steps):
        q = (A @ p[:, None]).sum(2)
        step = size / ((p * q).sum((1, 2), keepdim=True) + 1e-12)
        x = x + step * p
        r = r - step * q
        now = (r * r).sum((1, 2), keepdim=True)
        p = r + now / (size + 1e-12) * p
        size = now
    return x
