"""The loss: points and poses up to one scale a scene, weighted by the error that the network itself expects."""

import torch
from torch import Tensor
from torch.nn import functional as F

from training.pointmap.network import PATCH, REFERENCE, Prediction
from training.pointmap.scenes import Batch

WEIGHTS = {"depth": 1.0, "likelihood": 0.3, "slope": 1.0, "rays": 1.0, "matches": 1.0}
"""Of the terms of `terms` that are trained."""
FAR = 20.0
"""Metres: true depth beyond it is not learnt."""
HIDDEN = 0.05
"""Relative difference of depth beyond which a place is hidden behind what the other view shows there."""


def terms(out: Prediction, batch: Batch) -> dict[str, Tensor]:
    """The terms of the loss, each a mean over the batch.

    - depth: |log z| against the truth, after the median of each scene is taken out;
    - likelihood: negative log-likelihood of that error under a Laplace distribution of the expected width (Kendall and
      Gal 2017), which is what makes the confidence;
    - slope: differences of the error between neighbours 1, 2 and 4 pixels apart: shape and edges;
    - rays: where the points lie beside the axis, as tangents;
    - matches: cross entropy of the patches that show the same place, or none, in all ordered pairs of views;
    - rotation, translation (not trained, they follow): chord of the angle between true and solved relative rotation,
      and distance of the relative translations over the scene's median depth, all ordered pairs of views.
    """
    valid = (batch.depth > 0.05) & (batch.depth < FAR)
    truth = batch.depth.clamp(0.05, FAR).log()
    shift = scene_shift(out.log_z.detach(), truth, valid)
    off = torch.where(valid, out.log_z + shift[:, None, None, None] - truth, 0.0)
    weight = valid.sum().clamp(min=1)
    error = off.abs().clamp(max=2)
    expected = out.log_error.clamp(-4, 4)
    # The width follows the error and not the other way round: at first it would weigh six times the depth's own term.
    likelihood = torch.where(valid, error.detach() / REFERENCE * (-expected).exp() + expected, 0.0)
    true_rays = batch.local_points()[..., :2] / batch.depth.clamp(min=0.05)[..., None]
    rays = ((out.rays - true_rays).abs().sum(-1) * valid).sum() / weight
    with torch.no_grad():
        rotation, translation = _poses(out, batch, shift, truth, valid)
    return {
        "depth": error.sum() / weight, "likelihood": likelihood.sum() / weight, "slope": _slopes(off, valid),
        "rays": rays, "matches": _matches(out.matches, batch), "rotation": rotation, "translation": translation,
    }  # fmt: skip


def total(parts: dict[str, Tensor]) -> Tensor:
    """The weighted sum of what is trained."""
    return torch.stack([weight * parts[name] for name, weight in WEIGHTS.items()]).sum()


def scene_shift(log_z: Tensor, truth: Tensor, valid: Tensor) -> Tensor:
    """(B,) logarithm of the scale that takes predictions to the truth: the median over all valid pixels of a scene."""
    off = torch.where(valid, truth - log_z, torch.nan).flatten(1)
    step = max(1, off.shape[1] // 20000)
    return torch.nan_to_num(off[:, step // 2 :: step].nanmedian(1).values)


def _slopes(off: Tensor, valid: Tensor) -> Tensor:
    total = off.new_zeros(())
    for step in (1, 2, 4):
        for axis in (-2, -1):
            n = off.shape[axis]
            a, b = (off.narrow(axis, k, n - step) for k in (0, step))
            both = valid.narrow(axis, 0, n - step) & valid.narrow(axis, step, n - step)
            total = total + ((a - b).abs().clamp(max=1) * both).sum() / both.sum().clamp(min=1) / 6
    return total


def _matches(log_match: Tensor, batch: Batch) -> Tensor:
    target, known = partners(batch)
    apart = ~torch.eye(target.shape[1], dtype=torch.bool, device=target.device)[:, :, None]
    counted = known[:, :, None] & apart
    missed = -(target * log_match).sum(-1)
    return torch.where(counted, missed, 0.0).sum() / counted.sum().clamp(min=1)


@torch.no_grad()
def partners(batch: Batch) -> tuple[Tensor, Tensor]:
    """(B, V, V, N, N + 1) the share of each patch of view j in what the middle of a patch of view i shows, the last
    entry 1 where view j does not show it; (B, V, N) whether the place is known at all.

    A place between the middles of four patches belongs to each by its nearness (bilinear weights).
    """
    b, v, h, w = batch.depth.shape
    rows, columns = h // PATCH, w // PATCH
    middle = (slice(PATCH // 2, None, PATCH),) * 2
    known = (batch.depth[:, :, *middle] > 0).flatten(2)
    world = batch.first_points()[:, :, *middle].flatten(2, 3)
    R, t, K = batch.T[..., :3, :3], batch.T[..., :3, 3], batch.K
    there = torch.einsum("bjcd,bijnc->bijnd", R, world[:, :, None] - t[:, None, :, None])
    z = there[..., 2].clamp(min=1e-3)
    u, r = (K[:, None, :, k, k, None] * there[..., k] / z + K[:, None, :, k, 2, None] for k in (0, 1))
    inside = (u > -0.5) & (u < w - 0.5) & (r > -0.5) & (r < h - 0.5) & (there[..., 2] > 1e-3)
    pixel = r.round().clamp(0, h - 1).long() * w + u.round().clamp(0, w - 1).long()
    seen = torch.gather(batch.depth.flatten(2)[:, None].expand(b, v, v, h * w), 3, pixel)
    shown = inside & ((seen - z).abs() < HIDDEN * z) & known[:, :, None]
    x = ((u - PATCH // 2) / PATCH).clamp(0, columns - 1)
    y = ((r - PATCH // 2) / PATCH).clamp(0, rows - 1)
    near_x = (1 - (x[..., None] - torch.arange(columns, device=x.device)).abs()).clamp(min=0)
    near_y = (1 - (y[..., None] - torch.arange(rows, device=y.device)).abs()).clamp(min=0)
    share = (near_y[..., :, None] * near_x[..., None, :]).flatten(-2) * shown[..., None]
    return torch.cat([share, (~shown).float()[..., None]], -1), known


def _poses(out: Prediction, batch: Batch, shift: Tensor, truth: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    R, t = batch.T[..., :3, :3], batch.T[..., :3, 3]
    if R.shape[1] < 2:
        return out.log_z.new_zeros(()), out.log_z.new_zeros(())
    found, true = relative(out.R, out.t * shift.exp()[:, None, None]), relative(R, t)
    apart = ~torch.eye(R.shape[1], dtype=torch.bool, device=R.device)
    # |R - R'| = 2 sqrt(2) sin(angle / 2): its gradient does not vanish or explode anywhere below a half turn.
    chord = ((found[0] - true[0]) ** 2).sum((-1, -2)).clamp(min=1e-8).sqrt() / 2**0.5
    size = torch.where(valid, truth, torch.nan).flatten(1)[:, ::7].nanmedian(1).values.nan_to_num().exp()
    moved = ((found[1] - true[1]) ** 2).sum(-1).clamp(min=1e-10).sqrt() / size[:, None, None]
    return chord[:, apart].mean(), F.smooth_l1_loss(moved[:, apart], torch.zeros_like(moved[:, apart]), beta=0.02)


def relative(R: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation (B, V, V, 3, 3) and translation (B, V, V, 3) of camera j in camera i, whatever the world is."""
    back = R.transpose(-1, -2)[:, :, None]
    return back @ R[:, None], (back @ (t[:, None] - t[:, :, None])[..., None])[..., 0]
