"""Many views' samples into one thin, oriented, weighted point set: a sparse grid, then a bilateral projection.

Views are visited once each; what is kept grows with the surface, not with the number of views.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from realsim.core.meshes import sum_by_key
from realsim.core.ordered import by_rows
from realsim.core.types import F64, U8, Bool
from realsim.meshing.views import Samples

Rows = np.ndarray
"""(M, COLUMNS) sums of one grid cell a row."""
COLUMNS = 12
"""weight, weighted point (3), weighted normal (3), weighted colour (3), samples, views."""


@dataclass(frozen=True)
class Points:
    """Fused points, simulation frame."""

    points: F64
    """(M, 3) metres."""
    normals: F64
    """(M, 3) unit, out of the surface."""
    weights: F64
    """(M,) 1/m^2."""
    views: F64
    """(M,) how many views measured it."""
    colors: U8 | None
    """(M, 3) RGB or None."""

    def __len__(self) -> int:
        return len(self.points)

    def where(self, mask: Bool) -> Points:
        """Those points only."""
        colors = None if self.colors is None else self.colors[mask]
        return Points(self.points[mask], self.normals[mask], self.weights[mask], self.views[mask], colors)


class Grid:
    """Sums over the cells of a sparse grid. Samples of one cell that face different ways are kept apart.

    Without that, the rounded average of a top and a side would stand where there should be an edge.
    """

    def __init__(self, bounds: F64, cell: float) -> None:
        self.lower, self.cell = bounds[0], cell
        self.shape = np.maximum(np.ceil((bounds[1] - bounds[0]) / cell).astype(np.int64), 1) + 1
        self._keys = np.zeros(0, np.int64)
        self._rows = np.zeros((0, COLUMNS))
        self._pending: list[tuple[np.ndarray, Rows]] = []
        self.has_color = True

    def keys_of(self, points: F64, normals: F64) -> np.ndarray:
        """(M,) number of the cell and of the axis that the normal is nearest to."""
        index = np.clip(((points - self.lower) / self.cell).astype(np.int64), 0, self.shape - 1)
        axis = np.argmax(np.abs(normals), axis=1)
        facing = 2 * axis + (normals[np.arange(len(axis)), axis] > 0)
        return ((index[:, 0] * self.shape[1] + index[:, 1]) * self.shape[2] + index[:, 2]) * 6 + facing

    def rows_of(self, s: Samples) -> tuple[np.ndarray, Rows]:
        """One view's cells: sorted keys and sums (may run in another thread)."""
        key = self.keys_of(s.points, s.normals)
        rows = np.zeros((len(key), COLUMNS))
        w = s.weights
        rows[:, 0] = w
        rows[:, 1:4] = w[:, None] * s.points
        rows[:, 4:7] = w[:, None] * s.normals
        if s.colors is not None:
            rows[:, 7:10] = w[:, None] * s.colors
        rows[:, 10] = 1
        keys, rows = sum_by_key(key, rows)
        rows[:, 11] = 1
        return keys, rows

    def add(self, keys: np.ndarray, rows: Rows) -> None:
        """Add one view's cells. The order of the calls is the order of the sums: keep it fixed for equal bytes."""
        self._pending.append((keys, rows))
        if sum(len(k) for k, _ in self._pending) > 1_000_000:
            self._merge()

    def _merge(self) -> None:
        parts = [(self._keys, self._rows), *self._pending]
        self._keys, self._rows = sum_by_key(
            np.concatenate([k for k, _ in parts]), np.concatenate([r for _, r in parts])
        )
        self._pending = []

    def points(self, *, has_color: bool) -> Points:
        """The fused points in the order of their cells. Cells whose samples contradict each other are left out."""
        self._merge()
        rows = self._rows[self._rows[:, 0] > 0]
        w = rows[:, :1]
        mean_normal = rows[:, 4:7] / w
        length = np.linalg.norm(mean_normal, axis=1)
        ok = length > 0.5
        rows, w = rows[ok], w[ok]
        colors = np.clip(np.rint(rows[:, 7:10] / w), 0, 255).astype(np.uint8) if has_color else None
        return Points(rows[:, 1:4] / w, mean_normal[ok] / length[ok, None], w[:, 0], rows[:, 11], colors)


def project(points: Points, radius: float, iterations: int = 2, neighbours: int = 24) -> tuple[Points, float]:
    """Move points along their normals onto the local surface; also smooths the normals. Returns the noise before.

    Bilateral moving least squares: neighbours count by distance, by how alike they face, and by weight, so that a
    point at an edge listens only to its own face (after Fleishman et al., Robust Moving Least-Squares, 2005). Points
    whose neighbours nearly all face another way are dropped: their normal is wrong.
    The noise is the robust deviation of a point from its neighbours' plane, metres.
    """
    from scipy.spatial import cKDTree

    P, N = points.points, points.normals
    if len(P) < neighbours:
        return points, 0.0
    tree = cKDTree(P)
    distance, near = tree.query(P, k=neighbours, distance_upper_bound=2 * radius, workers=2)
    near[near == len(P)] = 0  # at an infinite distance

    def moved(some: slice) -> tuple[F64, F64, F64, Bool]:
        """Of some points: places, normals, by how much they moved, and whether neighbours face their way."""
        p, n, around = P[some], N[some], N[near[some]]
        base = np.exp(-0.5 * (distance[some] / radius) ** 2) * points.weights[near[some]]
        w = base * np.exp((np.minimum(np.einsum("mki,mi->mk", around, n), 1) - 1) / 0.06)
        offset = np.einsum("mki,mi->mk", P[near[some]] - p[:, None], n)
        move = (w * offset).sum(1) / np.maximum(w.sum(1), 1e-12)
        # Even in a corner of three faces a good point finds a quarter of its neighbours facing its way.
        other = distance[some] >= 1e-9
        alike = (w * other).sum(1) > 0.1 * (base * other).sum(1)
        normal = np.einsum("mk,mki->mi", w, around)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return p + np.clip(move, -radius, radius)[:, None] * n, normal, move, alike

    P, N, move, alike = by_rows(moved, len(P))
    noise = float(1.4826 * np.median(np.abs(move)))
    for _ in range(1, iterations):
        P, N, *_ = by_rows(moved, len(P))
    return Points(P, N, points.weights, points.views, points.colors).where(alike), noise


def drop_tails(points: Points, radius: float, ratio: float = 0.05) -> Points:
    """Without the thin tails of the noise: points that weigh little beside a neighbour that faces the same way.

    A surface that was seen once and far from anything better stays.
    """
    from scipy.spatial import cKDTree

    strong = points.weights >= np.quantile(points.weights, 0.6)
    weak = np.flatnonzero(~strong)
    if len(weak) == 0:
        return points
    S = points.where(strong)
    k = min(8, len(S))
    _, near = cKDTree(S.points).query(points.points[weak], k=k, distance_upper_bound=radius, workers=2)
    near = near.reshape(len(weak), k)
    found = near < len(S)
    near[~found] = 0
    alike = np.einsum("mki,mi->mk", S.normals[near], points.normals[weak]) > 0.7
    best = np.where(found & alike, S.weights[near], 0).max(1)
    keep = np.ones(len(points), bool)
    keep[weak] = points.weights[weak] >= ratio * best
    return points.where(keep)


def thin(points: Points, cell: float) -> Points:
    """One point a grid cell and facing: the weighted mean. After `project` nothing is lost but the crowd."""
    lower = points.points.min(0) if len(points) else np.zeros(3)
    upper = points.points.max(0) if len(points) else np.zeros(3)
    grid = Grid(np.stack([lower, upper]), cell)
    keys, rows = grid.rows_of(Samples(points.points, points.normals, points.weights, points.colors))
    views = sum_by_key(grid.keys_of(points.points, points.normals), points.views[:, None])[1][:, 0]
    rows[:, 11] = views / rows[:, 10]
    grid.add(keys, rows)
    return grid.points(has_color=points.colors is not None)
