"""Materials evaluated at the point that a ray hits: no texture coordinates, no seams.

Every material has two colours, a pattern that mixes them, and noise on top. Detail finer than a pixel's footprint
fades away, as it does in a camera.
"""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from training.pointmap.draw import Draw

PATTERNS = (
    "plain", "blotches", "checks", "bricks", "wood", "stripes", "speckle", "tiles", "marble", "mosaic", "print",
    "planks", "labels",
)  # fmt: skip
_WEIGHTS = (2.0, 2.0, 0.7, 0.7, 2.0, 0.7, 1.5, 1.0, 1.0, 0.6, 1.0, 1.5, 1.2)
_CELLS = 64
"""Period of the noise."""


@dataclass(frozen=True)
class Materials:
    """M materials of each of B scenes."""

    pattern: Tensor
    """(B, M) index into PATTERNS."""
    colors: Tensor
    """(B, M, 2, 3) linear RGB."""
    size: Tensor
    """(B, M) metres: length of a period."""
    grain: Tensor
    """(B, M) strength of the noise."""
    bump: Tensor
    """(B, M) how far noise tilts the normal."""
    gloss: Tensor
    """(B, M) strength of the highlight."""


def materials(draw: Draw, scenes: int, count: int) -> Materials:
    """Random ones. Colours are mostly dull, the second one mostly near the first, as in buildings."""
    base = draw.uniform(0.05, 0.75, scenes, count, 1, 1)
    tint = 1 + draw.normal(0.15, scenes, count, 1, 3)
    vivid = draw.uniform(0.02, 0.9, scenes, count, 1, 3)
    first = torch.where(draw.chance(0.15, scenes, count, 1, 1), vivid, base * tint)
    near = first * draw.log_uniform(0.35, 2.0, scenes, count, 1, 1) * (1 + draw.normal(0.1, scenes, count, 1, 3))
    other = draw.uniform(0.02, 0.9, scenes, count, 1, 3)
    second = torch.where(draw.chance(0.2, scenes, count, 1, 1), other, near)
    return Materials(
        pattern=draw.choice(_WEIGHTS, scenes, count),
        colors=torch.cat([first, second], 2).clamp(0.01, 0.95),
        size=draw.log_uniform(0.03, 0.8, scenes, count),
        grain=draw.log_uniform(0.04, 0.8, scenes, count),
        bump=draw.log_uniform(0.005, 0.25, scenes, count),
        gloss=torch.where(draw.chance(0.3, scenes, count), draw.uniform(0.05, 0.5, scenes, count), 0.0),
    )


def paint(m: Materials, which: Tensor, points: Tensor, footprint: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Colour, tilt of the normal and gloss at surface points.

    Args:
        which: (B, N) material.
        points: (B, N, 3) in the surface's own frame, metres.
        footprint: (B, N) size of the pixel there, metres.

    Returns:
        (B, N, 3) linear RGB, (B, N, 3) to be added to the normal, (B, N).
    """
    rows = torch.arange(len(points), device=points.device)[:, None]
    size, grain = m.size[rows, which][..., None], m.grain[rows, which][..., None]
    q = points / size
    blur = (footprint[..., None] / size).clamp(max=10)
    coarse, fine = noise(q * 0.9), noise(points * 9.0 + 5.3)
    finest = noise(points * 47.0 + 11.7)
    fine = fine * _kept(footprint * 9.0)[..., None]
    finest = finest * _kept(footprint * 47.0)[..., None]
    mix = _patterns(q, coarse, fine, finest, blur[..., 0])
    mix = mix.gather(-1, m.pattern[rows, which][..., None])
    pair = m.colors[rows, which]
    color = torch.lerp(pair[..., 0, :], pair[..., 1, :], mix)
    shade = grain * (0.5 * coarse[..., :1] + 0.7 * fine[..., :1] + 0.7 * finest[..., :1])
    tilt = m.bump[rows, which][..., None] * (fine[..., 1:4] + finest[..., 1:4])
    return (color * (1 + shade)).clamp(0.004, 1), tilt, m.gloss[rows, which]


def _patterns(q: Tensor, coarse: Tensor, fine: Tensor, finest: Tensor, blur: Tensor) -> Tensor:
    """(B, N, len(PATTERNS)) 0..1: how much of the second colour, by every pattern."""
    cell = q.floor()
    inside = q - cell
    seen = _kept(2 * blur)
    parity = ((cell[..., 0] + cell[..., 1] + cell[..., 2]) % 2 - 0.5) * seen + 0.5
    row = (q[..., 2] * 2).floor() + (q[..., 1] * 2).floor()
    brick_x = q[..., 0] + 0.5 * (row % 2)
    joint = ((brick_x - brick_x.floor()) < 0.06) | ((q[..., 2] * 2) % 1 < 0.12) | ((q[..., 1] * 2) % 1 < 0.12)
    bricks = torch.where(joint, 1.0, 0.25 + 0.5 * (_hash(torch.stack([brick_x.floor(), row, row], -1)) - 0.5))
    rings = torch.sin(12 * ((q[..., 0] ** 2 + q[..., 1] ** 2).sqrt() + 0.25 * coarse[..., 2]) + 2 * fine[..., 2])
    line = torch.sin(6.28 * (q[..., 0] + 0.4 * q[..., 1] + 0.7 * q[..., 2]))
    tile = ((inside - 0.5).abs().amax(-1) > 0.485).float() + 0.15 * (_hash(cell) - 0.5)
    marble = (
        torch.sin(5 * (q[..., 0] + q[..., 1] + q[..., 2] + 1.5 * coarse[..., 1] + 0.5 * fine[..., 2])).abs() * 2
    ).clamp(max=1)
    patch = _hash((q * 0.7 + 0.35 * coarse[..., :3]).floor())
    # Rows of dark marks inside some cells, as print on a box.
    mark = (
        (_hash((q * q.new_tensor([23.0, 23.0, 9.0])).floor()) > 0.5) & (q[..., 2] * 9 % 1 > 0.5) & (_hash(cell) > 0.6)
    )
    # Boards beside each other, each of its own tone, with grain along it and thin joints.
    side = q[..., 1] + q[..., 2]
    board = q[..., 0] / 5 + _hash(torch.stack([side.floor(), side.floor(), side.floor()], -1))
    tone = _hash(torch.stack([board.floor(), side.floor(), board.floor()], -1)) - 0.5
    grain = torch.sin(40 * side + 5 * coarse[..., 3] + 3 * fine[..., 3]) * _kept(7 * blur)
    gap = ((side % 1 < 0.025) | (board % 1 < 0.005)).float() * _kept(20 * blur)
    # A sheet with rows of writing on each of some cells, as the labels of a carton.
    sheet = ((inside - 0.5).abs() < q.new_tensor([0.33, 0.33, 0.24])).all(-1) & (_hash(cell) > 0.5)
    letters = (_hash((q * 24).floor()) > 0.45) & (q[..., 2] * 12 % 1 > 0.5)
    out = [
        0 * parity,
        ((coarse[..., 1] + 0.5 * fine[..., 1]) * 3 + 0.5).clamp(0, 1),
        parity,
        torch.lerp(bricks.new_tensor(0.4).expand_as(bricks), bricks, seen),
        0.5 + 0.4 * rings * seen,
        ((line * 4 * seen) + 0.5).clamp(0, 1),
        ((finest[..., 3] - 0.25) * 8).clamp(0, 1),
        tile * _kept(20 * blur),
        marble * seen,
        patch,
        0.9 * mark.float() * _kept(20 * blur),
        torch.maximum(0.4 + 0.5 * tone + 0.15 * grain, gap),
        sheet.float() * (1 - 0.7 * letters.float() * _kept(24 * blur)),
    ]
    return torch.stack(out, -1).clamp(0, 1)


def _kept(periods_a_pixel: Tensor) -> Tensor:
    """Share of a pattern's contrast that is left when a pixel covers so many of its periods."""
    return (1.5 - 2 * periods_a_pixel).clamp(0, 1)


def _hash(cell: Tensor) -> Tensor:
    """(...) 0..1 for integer cells (..., 3)."""
    index = cell.long() % _CELLS
    flat = (index[..., 0] * _CELLS + index[..., 1]) * _CELLS + index[..., 2]
    return _table(str(cell.device))[flat % (_CELLS**3)]


def noise(q: Tensor) -> Tensor:
    """(..., 4) smooth noise of about unit amplitude at points (..., 3), one wave a unit; it repeats after _CELLS."""
    wrapped = q - (q / _CELLS).floor() * _CELLS
    grid = (wrapped / _CELLS * 2 - 1).reshape(1, 1, 1, -1, 3)
    found = torch.nn.functional.grid_sample(
        _volume(str(q.device)), grid.flip(-1), mode="bilinear", align_corners=True, padding_mode="border"
    )
    return found.reshape(4, -1).T.reshape(*q.shape[:-1], 4)


@cache
def _volume(device: str) -> Tensor:
    """(1, 4, C + 1, C + 1, C + 1) uniform noise whose last layers repeat the first."""
    values = torch.rand((1, 4, _CELLS, _CELLS, _CELLS), generator=torch.Generator().manual_seed(1)) * 2 - 1
    for axis in (2, 3, 4):
        values = torch.cat([values, values.narrow(axis, 0, 1)], axis)
    return values.to(device)


@cache
def _table(device: str) -> Tensor:
    """(C^3,) uniform numbers."""
    return torch.rand(_CELLS**3, generator=torch.Generator().manual_seed(2)).to(device)
