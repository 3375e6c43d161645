"""The network: pictures, and sensor depth where there is any, to points in every camera, poses and confidence.

A convolutional stem down to patches of 16 pixels; blocks of attention within each view, then in turn within views and
over all of them (alternating attention as in VGGT, Wang et al. 2025); a convolutional decoder with the stem's features
beside it. No view is special: the order of views changes nothing but the order of the answers (Pi3, Wang et al. 2025).
Depth, and the intrinsics, may be zero: then they are unknown (MapAnything, Keetha et al. 2025).

Poses are not regressed. The network says which patches of two views show the same place (a softmax over all patches and
"none of them", as SuperGlue, Sarlin et al. 2020); `poses` solves for the rest, and where there is no sensor depth
`bundle` adjusts poses and depth together.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from realsim.core.errors import RealsimError
from training.pointmap import bundle, poses

PATCH = 16
"""Pixels; height and width are multiples of it."""
MIDDLE = (slice(PATCH // 2, None, PATCH),) * 2
"""Pixels of a map that are in the middle of patches."""
_INPUTS = 9
"""Channels of the stem: RGB, depth, whether there is depth, place in the picture (2), rays (2)."""


@dataclass(frozen=True)
class Shape:
    """The size of the network; the default has 11.3 M parameters."""

    dim: int = 320
    """Width of the blocks, a multiple of `heads`."""
    heads: int = 5
    frame_blocks: int = 2
    """Blocks within views before the alternation."""
    pairs: int = 3
    """Alternations: a block within views and a block over all."""
    stem: tuple[int, int, int] = (32, 64, 128)
    """Channels at 1/2, 1/4 and 1/8 of the size, in the stem and in the decoder."""

    def __post_init__(self) -> None:
        if self.dim % self.heads or min(self.dim, self.heads, self.pairs, *self.stem) < 1 or self.frame_blocks < 0:
            raise RealsimError(
                "the network cannot have this shape", expected="a width that is a multiple of the heads, all above 0",
                found=str(self),
            )  # fmt: skip


TINY = Shape(dim=32, heads=2, frame_blocks=0, pairs=1, stem=(8, 12, 16))
"""For tests."""
SMALL = Shape(dim=160, heads=4, frame_blocks=1, pairs=2, stem=(16, 32, 64))
"""For a run on a CPU."""
SHAPES = {"tiny": TINY, "small": SMALL, "full": Shape()}


@dataclass(frozen=True)
class Prediction:
    """What the network says of B scenes of V views, in one unknown scale a scene."""

    rays: Tensor
    """(B, V, H, W, 2) x / z and y / z of the points."""
    log_z: Tensor
    """(B, V, H, W)."""
    log_error: Tensor
    """(B, V, H, W) logarithm of the relative error that it expects, over `REFERENCE`."""
    R: Tensor
    """(B, V, 3, 3) camera to a world of its own."""
    t: Tensor
    """(B, V, 3)."""
    matches: Tensor
    """(B, V, V, N, N + 1) logarithm of the probability that patch n of view i shows the place that is in the middle of
    patch m of view j; the last entry: view j does not show it. Patches row by row."""

    def points(self) -> Tensor:
        """(B, V, H, W, 3) in each camera's frame."""
        z = self.log_z.exp()[..., None]
        return torch.cat([self.rays * z, z], -1)


DESCRIPTOR = 128
"""Numbers that tell a patch from others."""
REFERENCE = 0.05
"""Relative error of depth at which the confidence is one half."""


class PointmapNet(nn.Module):
    """See the module."""

    def __init__(self, shape: Shape = SHAPES["full"]) -> None:
        super().__init__()
        self.shape = shape
        a, b, c = shape.stem
        self.down = nn.ModuleList(
            [_Down(_INPUTS, a), _Down(a, b), _Down(b, c), nn.Conv2d(c, shape.dim, 3, stride=2, padding=1)]
        )
        self.place = nn.Linear(16, shape.dim)
        blocks = shape.frame_blocks + 2 * shape.pairs
        self.blocks = nn.ModuleList(_Block(shape.dim, shape.heads) for _ in range(blocks))
        self.norm = nn.LayerNorm(shape.dim)
        self.up = nn.ModuleList([_Up(shape.dim, c, c), _Up(c, b, b), _Up(b, a, a)])
        self.last = nn.Sequential(nn.Conv2d(a + _INPUTS, a, 3, padding=1), nn.GELU(), nn.Conv2d(a, 5, 3, padding=1))
        self.describe = nn.Linear(shape.dim, DESCRIPTOR + 1)
        self.sharpness = nn.Parameter(torch.tensor(3.0))
        self._initialise()

    def _initialise(self) -> None:
        for m in self.modules():
            if isinstance(m, nn.Linear):
                # With the usual 0.02 and damped residuals views hardly looked at each other (README.md).
                nn.init.trunc_normal_(m.weight, std=m.in_features**-0.5)
                nn.init.zeros_(m.bias)
        weight, bias = list(self.last.parameters())[-2:]
        nn.init.normal_(weight, std=1e-3)
        nn.init.zeros_(bias)

    def forward(self, images: Tensor, depths: Tensor, K: Tensor, adjusted: bool = True) -> Prediction:
        """The prediction; its unit is that of `depths` where there are any.

        Args:
            images: (B, V, 3, H, W) RGB 0..1.
            depths: (B, V, H, W) metres, 0 where unknown.
            K: (B, V, 3, 3) pixels; all zero where unknown.
            adjusted: whether scenes without depth are adjusted to their matches; the loss is that of what the network
                says itself.
        """
        b, v, _, h, w = images.shape
        there = (depths > 0).float()
        log_d = torch.log(depths.clamp(min=1e-3)) * there
        unit = log_d.sum((1, 2, 3)) / there.sum((1, 2, 3)).clamp(min=1)
        relative = (log_d - unit[:, None, None, None]) * there
        place, rays = self._directions(K, h, w)
        x = torch.cat([images * 4 - 2, relative[:, :, None], there[:, :, None], place, rays], 2).flatten(0, 1)
        maps, patches = self._features(x, v)
        delta, log_z, gate, log_error = maps.unflatten(0, (b, v)).split([2, 1, 1, 1], 2)
        # Without intrinsics: the middle of the lenses that were trained on.
        known = (K[..., 0, 0] > 0).float()[..., None, None, None]
        base = known * rays + (1 - known) * place * 0.6
        trust = torch.sigmoid(gate[:, :, 0] + 2) * there
        z = trust * relative + (1 - trust) * (log_z[:, :, 0] + 0.7 * (1 - there.amax((1, 2, 3)))[:, None, None, None])
        rays, z = (base + delta).permute(0, 1, 3, 4, 2), z + unit[:, None, None, None]
        matches = self._matches(patches.unflatten(0, (b, v)))
        found = Prediction(rays, z, log_error[:, :, 0], *self._poses(rays, z, matches), matches)
        return self._adjusted(found, depths) if adjusted else found

    @staticmethod
    @torch.no_grad()
    def _poses(rays: Tensor, z: Tensor, matches: Tensor) -> tuple[Tensor, Tensor]:
        """By the middles of patches; without gradients, for matches and points have losses of their own."""
        far = z[:, :, *MIDDLE].exp()[..., None]
        points = torch.cat([rays[:, :, *MIDDLE] * far, far], -1).flatten(2, 3)
        with torch.autocast(z.device.type, enabled=False):
            return poses.solve(points, matches[..., :-1].exp())

    @staticmethod
    def _adjusted(found: Prediction, depths: Tensor) -> Prediction:
        """Scenes without sensor depth: depth, its expected error and poses in one adjustment. What a sensor measured is
        better."""
        h, w = depths.shape[-2:]
        blind = 1 - (depths > 0).to(depths.dtype).amax((1, 2, 3))
        rays, log_z = found.rays[:, :, *MIDDLE].flatten(2, 3), found.log_z[:, :, *MIDDLE].flatten(2)
        with torch.no_grad(), torch.autocast(depths.device.type, enabled=False):
            error = found.log_error.clamp(-4, 4).exp()
            usual = error.mean((2, 3))
            matches, grid = found.matches[..., :-1].exp(), (h // PATCH, w // PATCH)
            expected = REFERENCE * usual * blind[:, None]
            weights, R, t, told = bundle.adjust(rays, log_z, expected, matches, found.R, found.t, grid)
            added = bundle.correction(weights, h, w)
            told = F.interpolate(told.unflatten(2, grid), scale_factor=float(PATCH), mode="bilinear")
            left = bundle.left(told * (error / usual[..., None, None]).square())
        seen = 1 - blind[:, None, None]
        R, t = R + seen[..., None] * (found.R - R), t + seen * (found.t - t)
        return replace(found, log_z=found.log_z + added, log_error=found.log_error + left.log(), R=R, t=t)

    @staticmethod
    def _directions(K: Tensor, h: int, w: int) -> tuple[Tensor, Tensor]:
        """(B, V, 2, H, W) each: place in the picture -1..1, and rays x / z, y / z (0 where K is)."""
        u = torch.arange(w, device=K.device, dtype=torch.float32)[None, :].expand(h, w)
        r = torch.arange(h, device=K.device, dtype=torch.float32)[:, None].expand(h, w)
        known = K[..., 0, 0, None, None] > 0
        fx, fy = (K[..., i, i, None, None].clamp(min=1e-3) for i in (0, 1))
        x = torch.where(known, (u - K[..., 0, 2, None, None]) / fx, 0.0)
        y = torch.where(known, (r - K[..., 1, 2, None, None]) / fy, 0.0)
        place = torch.stack([(2 * u + 1) / w - 1, (2 * r + 1) / h - 1])
        return place.expand(*K.shape[:2], 2, h, w), torch.stack([x, y], 2)

    def _features(self, x: Tensor, views: int) -> tuple[Tensor, Tensor]:
        """Maps (B V, 5, H, W) and patches (B V, N, C) of the stem's input (B V, _INPUTS, H, W)."""
        skips, y = [x], x
        for layer in self.down:
            y = layer(y)
            skips.append(y)
        rows, columns = y.shape[-2:]
        tokens = y.flatten(2).transpose(1, 2) + self.place(_waves(rows, columns, y.device))
        for k, block in enumerate(self.blocks):
            over_all = k >= self.shape.frame_blocks and (k - self.shape.frame_blocks) % 2 == 1
            tokens = block(tokens, views if over_all else 1)
        tokens = self.norm(tokens)
        y = tokens.transpose(1, 2).unflatten(2, (rows, columns))
        for layer, skip in zip(self.up, (skips[3], skips[2], skips[1]), strict=True):
            y = layer(y, skip)
        y = F.interpolate(y, scale_factor=2.0, mode="bilinear")
        return self.last(torch.cat([y, x], 1)).float(), tokens

    def _matches(self, patches: Tensor) -> Tensor:
        """Log-probabilities (B, V, V, N, N + 1) of patches (B, V, N, C), see `Prediction`."""
        told = self.describe(patches).float()
        code, none = F.normalize(told[..., :-1], dim=-1), told[..., -1]
        alike = self.sharpness.exp() * torch.einsum("binc,bjmc->bijnm", code, code)
        none = none[:, :, None, :, None] + 0 * alike[..., :1]  # broadcast, for any number of views in the graph
        return torch.cat([alike, none], -1).log_softmax(-1)


def _waves(rows: int, columns: int, device: torch.device) -> Tensor:
    """(rows * columns, 16) sines of the patches' places, the same for every size of picture."""
    v = (torch.arange(rows, device=device, dtype=torch.float32)[:, None].expand(rows, columns) + 0.5) / rows
    u = (torch.arange(columns, device=device, dtype=torch.float32)[None].expand(rows, columns) + 0.5) / columns
    parts = [f(torch.pi * k * p) for p in (u, v) for k in (1, 2, 4, 8) for f in (torch.sin, torch.cos)]
    return torch.stack(parts, -1).reshape(rows * columns, 16)


class _Down(nn.Module):
    """Halves a map, and looks at it again."""

    def __init__(self, into: int, out: int) -> None:
        super().__init__()
        self.narrower = nn.Conv2d(into, out, 3, stride=2, padding=1)
        self.again = nn.Conv2d(out, out, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, out, H / 2, W / 2)."""
        x = F.gelu(self.narrower(x))
        return F.gelu(x + self.again(x))


class _Up(nn.Module):
    """Doubles a map and joins the stem's map of that size."""

    def __init__(self, into: int, beside: int, out: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(into, out, 1)
        self.join = nn.Conv2d(out + beside, out, 3, padding=1)
        self.again = nn.Conv2d(out, out, 3, padding=1)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """(B, out, 2 H, 2 W)."""
        x = F.interpolate(self.narrow(x), scale_factor=2.0, mode="bilinear")
        x = F.gelu(self.join(torch.cat([x, skip], 1)))
        return F.gelu(x + self.again(x))


class _Block(nn.Module):
    """Attention and a perceptron, each on normalised tokens and added to them."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.qkv, self.out = nn.Linear(dim, 3 * dim), nn.Linear(dim, dim)
        self.wide, self.back = nn.Linear(dim, 4 * dim), nn.Linear(4 * dim, dim)
        self.scale1, self.scale2 = (nn.Parameter(torch.ones(dim)) for _ in range(2))

    def forward(self, tokens: Tensor, views: int) -> Tensor:
        """Tokens (B V, N, C) looking at each other within groups of `views` consecutive entries."""
        rows, n, c = tokens.shape
        q, k, v = self.qkv(self.norm1(tokens)).reshape(-1, views * n, 3, self.heads, c // self.heads).unbind(2)
        seen = F.scaled_dot_product_attention(q.transpose(1, 2), k.transpose(1, 2), v.transpose(1, 2))
        tokens = tokens + self.scale1 * self.out(seen.transpose(1, 2).reshape(rows, n, c))
        return tokens + self.scale2 * self.back(F.gelu(self.wide(self.norm2(tokens))))


def count(net: nn.Module) -> int:
    """Number of parameters."""
    return sum(p.numel() for p in net.parameters())
