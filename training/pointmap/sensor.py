"""From light to a picture, and from true depth to a sensor's."""

import torch
from torch import Tensor
from torch.nn import functional as F

from training.pointmap.draw import Draw


def picture(draw: Draw, light: Tensor) -> Tensor:
    """(B, V, 3, H, W) 0..1 as a camera delivers linear light of that shape: exposure, defocus, noise, tone, JPEG.

    Most are exposed well, some are night, some burnt out; exposure and white balance differ a little between views. Of
    views among good ones, one in twelve is dark or burnt out and one in sixteen out of focus: they are what the
    confidence has to tell apart.
    """
    b, v = light.shape[:2]
    middle = light.mean((1, 2, 3, 4)).clamp(min=1e-3)
    aim = torch.where(draw.chance(0.12, b), draw.log_uniform(0.01, 1.2, b), draw.log_uniform(0.12, 0.4, b))
    gain = (aim / middle)[:, None] * (1 + draw.normal(0.08, b, v)).clamp(0.6, 1.5)
    gain = gain * torch.where(draw.chance(1 / 12, b, v), draw.log_uniform(0.02, 12, b, v), 1.0)
    white = (1 + draw.normal(0.08, b, 1, 3)) * (1 + draw.normal(0.01, b, v, 3))
    x = light * gain[..., None, None, None] * white[..., None, None]
    x = _vignette(x, draw.uniform(0, 0.4, b))
    x = _defocus(draw, x)
    read, shot = draw.log_uniform(5e-4, 0.012, b, 1, 1, 1, 1), draw.log_uniform(5e-4, 0.015, b, 1, 1, 1, 1)
    x = x + (read**2 + shot**2 * x.clamp(min=0)).sqrt() * draw.normal(1, *x.shape)
    curve = draw.uniform(0.4, 0.55, b, 1, 1, 1, 1)
    x = _developed(draw, x.clamp(0, 1) ** curve)
    x = jpeg(x.flatten(0, 1), draw.log_uniform(0.05, 1.5, b, 1).expand(b, v).flatten()).reshape(x.shape)
    return (x.clamp(0, 1) * 255).round() / 255


def _developed(draw: Draw, x: Tensor) -> Tensor:
    """Colours made stronger or weaker, and in half of the scenes edges made sharper, as phones and webcams do."""
    b = len(x)
    x = torch.lerp(x.mean(2, keepdim=True), x, draw.uniform(0.7, 1.4, b, 1, 1, 1, 1))
    smooth = F.avg_pool2d(x.flatten(0, 1), 3, 1, 1, count_include_pad=False).reshape(x.shape)
    sharpen = torch.where(draw.chance(0.5, b, 1, 1, 1, 1), draw.log_uniform(0.1, 1.2, b, 1, 1, 1, 1), 0.0)
    return (x + sharpen * (x - smooth)).clamp(0, 1)


def _vignette(x: Tensor, strength: Tensor) -> Tensor:
    h, w = x.shape[-2:]
    r2 = torch.linspace(-1, 1, h, device=x.device)[:, None] ** 2 + torch.linspace(-1, 1, w, device=x.device)[None] ** 2
    return x * (1 - strength[:, None, None, None, None] * r2 / 2)


def _defocus(draw: Draw, x: Tensor) -> Tensor:
    """A blur of one width a scene, in a third of them, and a wide one of single views."""
    b, v, c, h, w = x.shape
    sigma = torch.where(draw.chance(0.35, b, 1), draw.log_uniform(0.3, 1.8, b, 1), 1e-3)
    sigma = torch.where(draw.chance(1 / 16, b, v), draw.log_uniform(1.0, 4.0, b, v), sigma)
    sigma = sigma.flatten().repeat_interleave(c)
    reach = 8
    at = torch.arange(-reach, reach + 1, device=x.device)
    kernel = torch.exp(-0.5 * (at / sigma[:, None]) ** 2)
    kernel = kernel / kernel.sum(1, keepdim=True)
    flat = F.pad(x.reshape(1, -1, h, w), (reach,) * 4, mode="replicate")
    flat = F.conv2d(flat, kernel[:, None, None], groups=len(sigma))
    return F.conv2d(flat, kernel[:, None, :, None], groups=len(sigma)).reshape(x.shape)


_LUMA = (
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51,
    87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
)  # fmt: skip
"""Quantisation of brightness in JPEG's annex K, at quality 50."""


def jpeg(x: Tensor, strength: Tensor) -> Tensor:
    """Pictures (B, 3, H, W) 0..1 after rounding the cosine transform of 8x8 blocks as JPEG does.

    Args:
        strength: (B,) factor on the table of quality 50: 0.2 is quality 90, 1 is 50. Colour is rounded twice as much.
    """
    h, w = x.shape[-2:]
    to_ycc = x.new_tensor([[0.299, 0.587, 0.114], [-0.1687, -0.3313, 0.5], [0.5, -0.4187, -0.0813]])
    y = F.pad(torch.einsum("ij,bjhw->bihw", to_ycc, x), (0, -w % 8, 0, -h % 8), mode="replicate")
    k = torch.arange(8, device=x.device)
    D = torch.cos((2 * k[None] + 1) * k[:, None] * torch.pi / 16) / 2
    D[0] *= 0.5**0.5
    b, c, hh, ww = y.shape
    blocks = y.reshape(b, c, hh // 8, 8, ww // 8, 8).transpose(3, 4)
    step = x.new_tensor(_LUMA).reshape(8, 8) / 255 * strength[:, None, None, None, None, None]
    step = step * x.new_tensor([1.0, 2.0, 2.0])[:, None, None, None, None]
    blocks = D.T @ ((D @ blocks @ D.T) / step).round().mul(step) @ D
    y = blocks.transpose(3, 4).reshape(b, c, hh, ww)[..., :h, :w]
    return torch.einsum("ij,bjhw->bihw", torch.linalg.inv(to_ycc), y).clamp(0, 1)


def depth(draw: Draw, z: Tensor, focal: Tensor) -> Tensor:
    """(B, V, H, W) what a depth sensor makes of true depth along z, metres; 0 where it measures nothing.

    A scene has one sensor: stereo (noise and steps that grow with z^2, holes, flying pixels, a shadow beside near
    edges), LiDAR of a phone (coarse and smooth, short range), or structured light (holes at edges).

    Args:
        focal: (B,) pixels.
    """
    b, v, h, w = z.shape
    kind = draw.choice((0.6, 0.2, 0.2), b)[:, None, None, None]
    there = z > 0
    bias = 1 + draw.normal(0.006, b, 1, 1, 1)
    edge, near = _edges(z)
    flying = torch.where(edge & draw.chance(0.5, *z.shape), torch.lerp(z, near, draw.uniform(0, 1, *z.shape)), z)
    grain = F.interpolate(draw.normal(1, b * v, 1, -(-h // 3), -(-w // 3)), (h, w), mode="bilinear").reshape(z.shape)
    noise = 0.5 * draw.normal(1, *z.shape) + 1.0 * grain
    stereo = flying + noise * draw.log_uniform(4e-4, 4e-3, b, 1, 1, 1) * z**2
    disparity = focal[:, None, None, None] * draw.uniform(0.03, 0.09, b, 1, 1, 1) / stereo.clamp(min=0.05)
    steps = draw.log_uniform(0.01, 0.3, b, 1, 1, 1) * focal[:, None, None, None] / 300
    stereo = stereo * disparity / ((disparity / steps).round().clamp(min=1) * steps)
    coarse = F.avg_pool2d(z.flatten(0, 1)[:, None], 4, ceil_mode=True)
    lidar = F.interpolate(coarse, (h, w), mode="bilinear").reshape(z.shape)
    lidar = lidar + noise * draw.log_uniform(0.001, 0.012, b, 1, 1, 1)
    light = z + noise * draw.log_uniform(4e-4, 2e-3, b, 1, 1, 1) * z**2
    out = torch.where(kind == 0, stereo, torch.where(kind == 1, lidar, light)) * bias
    blobs = F.interpolate(draw.uniform(0, 1, b * v, 1, 7, 9), (h, w), mode="bicubic").reshape(z.shape)
    hole = blobs < draw.uniform(-0.1, 0.3, b, 1, 1, 1)
    hole |= edge & draw.chance(0.6, *z.shape) & (kind != 1)
    hole |= draw.chance(0.01, *z.shape) & (kind != 1)
    reach = torch.where(kind == 1, 5.0, draw.uniform(4.0, 10.0, b, 1, 1, 1))
    nearest = torch.where(kind == 1, 0.1, draw.uniform(0.1, 0.4, b, 1, 1, 1))
    measured = there & ~hole & (out < reach) & (out > nearest)
    return torch.where(measured, out, 0.0)


def _edges(z: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels beside a step of depth, and the nearest depth of the 3x3 about every pixel."""
    flat = z.flatten(0, 1)[:, None]
    far = F.max_pool2d(flat, 3, 1, 1).reshape(z.shape)
    near = -F.max_pool2d(-flat, 3, 1, 1).reshape(z.shape)
    return (far > 1.08 * near) & (near > 0), near
