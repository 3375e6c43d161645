"""Terrain around the soles: how deep a point lies in the tube around an edge, how high it is above the ground.

Heights come from rays straight down against the same mesh that the depth camera sees: exact on vertical faces, where a
height map would smear a cell. They are a few percent of the rays of the depth image.

Edges are looked up in a coarse grid: each cell lists the edges whose tube may reach into it, so a point is compared
with a handful of edges instead of all of them, and the result within the tube is exact.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from trainer.physics import State
from trainer.rays import RayCaster, fall
from trainer.tasks.parkour.body import Body
from trainer.tasks.parkour.signals import Footholds, sole_points
from trainer.terrain import Terrain

_CELL = 0.1
"""Metres a side of the lookup grid."""
_ABOVE = 0.15
"""Metres above a sole point at which its ray starts, so that a point slightly inside is seen to be inside."""
_FAR = 3.0
"""Metres after which a ray down has found nothing."""


class EdgeIndex:
    """Distance from points to the nearest of a terrain's edges, as far as a radius."""

    def __init__(self, edges: Sequence[np.ndarray], radius: float, device: torch.device) -> None:
        """`edges`: for each terrain (E, 2, 3) end points in metres."""
        self.radius = radius
        everything = [e for e in edges if len(e)]
        # Edge 0 is nowhere: padding that no point is near.
        nowhere = np.full((1, 2, 3), 1e6)
        flat = np.concatenate([nowhere, *everything]) if everything else nowhere
        low = flat[1:].reshape(-1, 3).min(0)[:2] - 2 * radius if everything else np.zeros(2)
        high = flat[1:].reshape(-1, 3).max(0)[:2] + 2 * radius if everything else np.zeros(2)
        self.shape = tuple(int(n) for n in np.ceil((high - low) / _CELL).astype(int) + 1)
        table = _table(edges, low, self.shape, radius)
        self.origin = torch.as_tensor(low, dtype=torch.float32, device=device)
        self.table = torch.as_tensor(table, device=device)
        along = flat[:, 1] - flat[:, 0]
        inverse = 1.0 / np.maximum((along**2).sum(-1, keepdims=True), 1e-9)
        self.edges = torch.as_tensor(
            np.concatenate([flat[:, 0], along, along * inverse], -1), dtype=torch.float32, device=device
        )
        """(E, 9): begin, extent, and extent / length^2 of each edge, side by side so that one look-up fetches all."""

    def depth(self, points: Tensor, terrain_ids: Tensor) -> Tensor:
        """(N, Q) metres inside the tube of `radius` around the nearest edge, 0 outside; points (N, Q, 3)."""
        cell = ((points[..., :2] - self.origin) / _CELL).nan_to_num(-1.0).floor().long()
        nx, ny = self.shape
        inside = (cell[..., 0] >= 0) & (cell[..., 0] < nx) & (cell[..., 1] >= 0) & (cell[..., 1] < ny)
        flat = (cell[..., 0].clamp(0, nx - 1) * ny + cell[..., 1].clamp(0, ny - 1)).clamp(0, nx * ny - 1)
        begin, along, scaled = self.edges[self.table[terrain_ids[:, None], flat]].split(3, -1)
        offset = points[..., None, :] - begin
        t = (offset * scaled).sum(-1, keepdim=True).clamp(0.0, 1.0)
        distance = (offset - t * along).norm(dim=-1).amin(-1)
        return (self.radius - distance).clamp_min(0.0) * inside


def _table(edges: Sequence[np.ndarray], low: np.ndarray, shape: tuple[int, ...], radius: float) -> np.ndarray:
    """(terrains, cells, K) indices into all edges (1-based; 0 pads): those whose tube may reach into the cell."""
    nx, ny = shape
    centres = np.stack(np.meshgrid(np.arange(nx) + 0.5, np.arange(ny) + 0.5, indexing="ij"), -1) * _CELL + low
    reach = radius + _CELL * 0.5**0.5
    offset, lists = 1, []
    for own in edges:
        pairs = [_cells(edge, centres, low, reach) for edge in own]
        cells = np.concatenate(pairs) if pairs else np.zeros(0, int)
        which = np.repeat(np.arange(len(own)) + offset, [len(p) for p in pairs])
        order = np.argsort(cells, kind="stable")
        lists.append((cells[order], which[order]))
        offset += len(own)
    width = max([1, *(np.bincount(cells).max() for cells, _ in lists if len(cells))])
    table = np.zeros((len(edges), nx * ny, width), np.int32)
    for i, (cells, which) in enumerate(lists):
        first = np.searchsorted(cells, cells, side="left")
        table[i, cells, np.arange(len(cells)) - first] = which
    return table


def _cells(edge: np.ndarray, centres: np.ndarray, low: np.ndarray, reach: float) -> np.ndarray:
    """Flat indices of the cells whose centre lies within `reach` of an edge (2, 3), seen from above."""
    nx, ny = centres.shape[:2]
    a, b = edge[:, :2]
    first = np.maximum(np.floor((np.minimum(a, b) - reach - low) / _CELL).astype(int), 0)
    last = np.minimum(np.ceil((np.maximum(a, b) + reach - low) / _CELL).astype(int) + 1, (nx, ny))
    block = centres[first[0] : last[0], first[1] : last[1]]
    t = np.clip(((block - a) @ (b - a)) / max(float((b - a) @ (b - a)), 1e-9), 0.0, 1.0)
    near = np.linalg.norm(block - a - t[..., None] * (b - a), axis=-1) <= reach
    i, j = np.nonzero(near)
    return (i + first[0]) * ny + (j + first[1])


class FootholdProbe:
    """Looks at the terrain around the soles of all worlds."""

    def __init__(
        self, terrains: Sequence[Terrain], edges: Sequence[np.ndarray], caster: RayCaster, body: Body, radius: float
    ) -> None:
        self.caster, self.body = caster, body
        self.edges = EdgeIndex(edges, radius, body.soles.device)

    def __call__(self, state: State, terrain_ids: Tensor) -> Footholds:
        points, speed = sole_points(state, self.body)
        worlds, feet, count, _ = points.shape
        flat = points.reshape(worlds, feet * count, 3)
        above = flat.clone()
        above[..., 2] += _ABOVE
        terrain_z = (above[..., 2] - fall(self.caster, above, terrain_ids, _FAR)).reshape(worlds, feet, count)
        depth = self.edges.depth(flat, terrain_ids).reshape(worlds, feet, count)
        return Footholds(terrain_z, points[..., 2] - terrain_z, depth, speed)
