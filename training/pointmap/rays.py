"""Rays against boxes, cylinders and ellipsoids, all scenes and all rays at once.

Every primitive is the image of a unit one, so a ray is taken into the unit primitive's own frame by a matrix, where
the distance along it stays what it is.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from training.pointmap.layouts import SLOTS

FAR = 1e4
"""Metres: no hit."""
NEAR = 1e-3
"""Metres: hits nearer than this are those of the surface that a ray starts on."""
_EDGES = (SLOTS["box"], SLOTS["box"] + SLOTS["cylinder"])


@dataclass(frozen=True)
class Solids:
    """Primitives of B scenes, P in each, ordered as `SLOTS` says."""

    A: Tensor
    """(B, P, 3, 3) world to unit primitive; its rows are the axes over the half extents."""
    centre: Tensor
    """(B, P, 3) metres; what is not there lies far away."""
    room: Tensor
    """(B, 3) half extents of the room about the origin in x and y, and its height from the floor z = 0."""


def solids(centre: Tensor, half: Tensor, R: Tensor, there: Tensor, room: Tensor) -> Solids:
    """Primitives by pose and half extents; those not `there` (B, P) are put where no ray comes."""
    A = R.transpose(-1, -2) / half[..., None]
    return Solids(A, torch.where(there[..., None], centre, centre.new_tensor([0.0, 0.0, -100 * FAR])), room)


def nearest(scene: Solids, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """First hits in front of `origin` (B, 1 or N, 3) along `direction` (B, N or 1, 3), the room left out.

    Returns:
        (B, N) distance in units of the direction's length, at least FAR where nothing is hit; (B, N) primitive.
    """
    start = _in_unit(scene, origin) - torch.einsum("bpij,bpj->ibp", scene.A, scene.centre)[:, :, None]
    return _first(start, _in_unit(scene, direction))


def _in_unit(scene: Solids, vectors: Tensor) -> Tensor:
    """(3, B, N, P) vectors (B, N, 3) in every primitive's unit frame."""
    return torch.stack([vectors @ scene.A[:, :, k].transpose(1, 2) for k in range(3)])


def _first(o: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Hits of rays given in unit frames, (3, B, N, P) each."""
    inverse = 1 / (d + 1e-12)
    middle, reach = o * -inverse, inverse.abs()
    low, high = middle - reach, middle + reach  # where the ray is between the two faces of each axis
    b, c = _EDGES
    x, y, z = low[..., :b]
    enter = torch.maximum(torch.maximum(x, y), z)
    x, y, z = high[..., :b]
    boxes = _hit(enter, torch.minimum(torch.minimum(x, y), z))
    side = _round(o[:2, ..., b:c], d[:2, ..., b:c])
    cylinders = _hit(torch.maximum(side[0], low[2, ..., b:c]), torch.minimum(side[1], high[2, ..., b:c]))
    balls = _hit(*_round(o[..., c:], d[..., c:]))
    t, which = torch.cat([boxes, cylinders, balls], -1).min(-1)
    return t, which


def _round(o: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays enter and leave the unit circle or ball; behind one another where they miss it."""
    # Unrolled: sums over a first axis of length three are slow.
    a, b, c = (sum(p * q for p, q in zip(u, v, strict=True)) for u, v in ((d, d), (o, d), (o, o)))
    a, c = a + 1e-9, c - 1  # along the axis of a cylinder a is zero: such a ray is inside for ever, or never
    inside = b * b - a * c
    root = inside.clamp(min=0).sqrt()
    miss = torch.where(inside > 0, 0.0, 2 * FAR)
    return (-b - root) / a + miss, (-b + root) / a - miss


def _hit(low: Tensor, high: Tensor) -> Tensor:
    return torch.where((low < high) & (low > NEAR), low, 2 * FAR)


def walls(scene: Solids, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays leave the room (B, N), and through which face: 0 floor, 1 ceiling, 2 to 5 the walls."""
    middle = torch.stack([0 * scene.room[:, 2], 0 * scene.room[:, 2], scene.room[:, 2] / 2], -1)[:, None]
    half = torch.stack([scene.room[:, 0], scene.room[:, 1], scene.room[:, 2] / 2], -1)[:, None]
    d = torch.where(direction.abs() < 1e-9, torch.full_like(direction, 1e-9), direction)
    leave = (half * d.sign() - (origin - middle)) / d
    t, axis = leave.min(-1)
    up = (d.gather(-1, axis[..., None])[..., 0] > 0).long()
    face = torch.where(axis == 2, up, 2 + 2 * axis + up)
    return t.clamp(min=NEAR), face


def surface(scene: Solids, points: Tensor, which: Tensor) -> tuple[Tensor, Tensor]:
    """Unit normals (B, N, 3) at points (B, N, 3) of primitives `which` (B, N), and the points in the primitives' own
    axes, metres."""
    rows = torch.arange(len(points), device=points.device)[:, None]
    A, centre = scene.A[rows, which], scene.centre[rows, which]
    unit = torch.einsum("bnij,bnj->bni", A, points - centre)
    b, c = _EDGES
    axis = torch.nn.functional.one_hot(unit.abs().argmax(-1), 3) * unit.sign()
    cap = unit[..., 2:].abs() > length(unit[..., :2])
    round_side = torch.cat([unit[..., :2], torch.zeros_like(unit[..., :1])], -1)
    flat_cap = torch.cat([torch.zeros_like(unit[..., :2]), unit[..., 2:].sign()], -1)
    local = torch.where(which[..., None] < b, axis, torch.where(cap, flat_cap, round_side))
    local = torch.where(which[..., None] >= c, unit, local)
    normal = torch.einsum("bnij,bni->bnj", A, local)
    return unit_length(normal), unit / length(A)[..., 0]


def length(v: Tensor) -> Tensor:
    """(..., 1) of vectors (..., 2 or 3); several times faster than torch's norm over so short an axis."""
    return sum((x * x for x in v[..., 1:].unbind(-1)), v[..., 0] * v[..., 0]).clamp(min=1e-18).sqrt()[..., None]


def dot(a: Tensor, b: Tensor) -> Tensor:
    """(..., 1) of vectors (..., 3), likewise."""
    return (a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])[..., None]


def unit_length(v: Tensor) -> Tensor:
    """(..., 3) of length one."""
    return v / length(v)
