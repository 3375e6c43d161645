"""Plain triangle surfaces and the small operations that every step shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across, areas, compact, edges_of, linked, merged, sampled
from realsim.core.rays import Rays
from realsim.core.types import F64, U8, Bool

I32 = NDArray[np.int32]


@dataclass(frozen=True)
class Surface:
    """Vertices (V, 3) metres, triangles (K, 3) counter-clockwise from outside, colours (V, 3) RGB or None."""

    vertices: F64
    triangles: I32
    colors: U8 | None = None

    def where(self, keep: Bool) -> Surface:
        """Those triangles only (K,), without the vertices that nothing uses."""
        return Surface(*compact(self.vertices, self.triangles[keep], self.colors))

    def joined(self, other: Surface) -> Surface:
        """Both in one, this one first; without colours."""
        vertices, triangles = merged([(s.vertices, s.triangles) for s in (self, other)])
        return Surface(vertices, triangles.astype(np.int32))

    def centres(self) -> F64:
        """(K, 3) centroids of the triangles."""
        return self.vertices[self.triangles].mean(1)

    def crosses(self) -> F64:
        """(K, 3) normals of twice the triangles' area."""
        return across(self.vertices, self.triangles)

    def areas(self) -> F64:
        """(K,) m^2."""
        return areas(self.vertices, self.triangles)

    def rays(self) -> Rays:
        """The surface under rays."""
        return Rays(self.vertices, self.triangles, self.vertices.mean(0) if len(self.vertices) else None)

    def distance(self, points: F64) -> F64:
        """(M,) metres from points (M, 3) to the surface."""
        return self.rays().distance(points)

    def sample(self, n: int, seed: int) -> F64:
        """(n, 3) points spread evenly over the area."""
        return sampled(self.vertices, self.triangles, n, np.random.default_rng(seed))[0]


def first_of_each(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each different row of (K, 2 or 3) non-negative numbers first occurs, in the order of the rows' values.

    As `np.unique(rows, axis=0, return_index=True)[1]`, but over one number a row, which sorts many times faster.
    """
    scale = int(rows.max()) + 1 if len(rows) else 1
    if scale ** rows.shape[1] > 2**63:
        return np.asarray(np.unique(rows, axis=0, return_index=True)[1])
    key = rows[:, 0]
    for column in rows.T[1:]:
        key = key * scale + column
    return np.asarray(np.unique(key, return_index=True)[1])


def components(triangles: I32) -> tuple[int, NDArray[np.int64]]:
    """Number of pieces connected through shared edges, and the piece of each triangle (K,)."""
    k = len(triangles)
    if k == 0:
        return 0, np.zeros(0, np.int64)
    edges = edges_of(triangles)
    _, label = np.unique(linked(np.arange(3 * k) // 3, k + edges.of_side, k + len(edges.uses))[:k], return_inverse=True)
    return int(label.max()) + 1, label.ravel().astype(np.int64)


def drop_islands(surface: Surface, min_area: float) -> tuple[Surface, int]:
    """Without the pieces smaller than `min_area` (m^2), and how many there were. The largest piece always stays."""
    n, label = components(surface.triangles)
    if n <= 1:
        return surface, 0
    area = np.bincount(label, surface.areas(), minlength=n)
    keep = area >= min(min_area, area.max())
    return surface.where(keep[label]), int((~keep).sum())


def colored_from(surface: Surface, points: F64, colors: U8 | None) -> Surface:
    """The surface with colours averaged from the nearest points (M, 3) with RGB (M, 3)."""
    from scipy.spatial import cKDTree

    if colors is None or len(points) == 0:
        return Surface(surface.vertices, surface.triangles)
    k = min(4, len(points))
    distance, near = cKDTree(points).query(surface.vertices, k=k, workers=2)
    distance, near = distance.reshape(-1, k), near.reshape(-1, k)
    w = 1 / (distance + 1e-4)
    mean = (w[..., None] * colors[near]).sum(1) / w.sum(1, keepdims=True)
    return Surface(surface.vertices, surface.triangles, np.clip(np.rint(mean), 0, 255).astype(np.uint8))
