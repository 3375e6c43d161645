"""Rays against a triangle mesh, by Open3D's ray caster (Embree), which calculates in float32."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from realsim.core.types import F64


def raycasting_scene(vertices: F64, triangles: NDArray[Any]) -> Any:
    """An Open3D `RaycastingScene` of a mesh, in the mesh's own coordinates."""
    from realsim.core.open3d import o3d

    scene: Any = o3d.t.geometry.RaycastingScene()  # its stubs know neither numpy arrays nor keyword defaults
    add(scene, vertices, triangles)
    return scene


def add(scene: Any, vertices: F64, triangles: NDArray[Any]) -> None:
    """Another mesh for such a scene."""
    from realsim.core.open3d import o3d

    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, np.uint32)),
    )


class Rays:
    """A mesh under rays: vertices (V, 3) metres, triangles (K, 3). Single precision is kept by moving all to a centre
    (3,) first: the middle of the mesh's box, if none is given."""

    def __init__(self, vertices: F64, triangles: NDArray[Any], centre: F64 | None = None) -> None:
        some = vertices if len(vertices) else np.zeros((1, 3))
        self.lower: F64 = some.min(0)
        self.upper: F64 = some.max(0)
        self.centre = (self.lower + self.upper) / 2 if centre is None else centre
        self._scene = raycasting_scene(vertices - self.centre, triangles)

    def _tensor(self, origins: F64, directions: F64) -> Any:
        from realsim.core.open3d import o3d

        return o3d.core.Tensor.from_numpy(np.concatenate([origins - self.centre, directions], -1).astype(np.float32))

    def cast(self, origins: F64, directions: F64) -> tuple[F64, NDArray[np.int64]]:
        """First hits of rays (..., 3): (...) distance in units of the direction's length, infinity for none, and the
        triangle, -1 for none."""
        if not origins.size:  # Open3D may crash on nothing at all, here and below
            return np.zeros(origins.shape[:-1]), np.zeros(origins.shape[:-1], np.int64)
        hit = self._scene.cast_rays(self._tensor(origins, directions))
        return hit["t_hit"].numpy().astype(np.float64), self._triangles(hit)

    def crossings(self, origins: F64, directions: F64) -> tuple[NDArray[np.int64], F64, NDArray[np.int64]]:
        """All hits of rays (N, 3), in no order: ray, distance and triangle, (M,) each."""
        if not len(origins):
            return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64)
        hits = self._scene.list_intersections(self._tensor(origins, directions))
        ray, t = hits["ray_ids"].numpy().astype(np.int64), hits["t_hit"].numpy().astype(np.float64)
        return ray, t, self._triangles(hits)

    def _triangles(self, hits: Any) -> NDArray[np.int64]:
        """Those that were hit, -1 for none."""
        triangle = hits["primitive_ids"].numpy().astype(np.int64)
        return np.where(triangle == self._scene.INVALID_ID, -1, triangle)

    def height(self, xy: F64) -> F64:
        """(M,) highest z above each x y (M, 2), NaN where there is none."""
        above = float(self.upper[2]) + 1.0
        origins = np.column_stack([xy, np.full(len(xy), above)])
        t, _ = self.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
        return np.where(np.isfinite(t), above - t, np.nan)

    def distance(self, points: F64) -> F64:
        """(...) metres from points (..., 3) to the mesh."""
        if not points.size:
            return np.zeros(points.shape[:-1])
        return np.asarray(self._scene.compute_distance(self._query(points)).numpy(), float)

    def nearest(self, points: F64) -> F64:
        """(..., 3) points of the mesh that are the nearest to points (..., 3)."""
        if not points.size:
            return points
        near = self._scene.compute_closest_points(self._query(points))["points"].numpy()
        return np.asarray(near, float) + self.centre

    def _query(self, points: F64) -> Any:
        from realsim.core.open3d import o3d

        return o3d.core.Tensor.from_numpy((points - self.centre).astype(np.float32))


def heights(vertices: F64, triangles: NDArray[Any], low: ArrayLike, high: ArrayLike, cell: float) -> F64:
    """(rows, columns) z of the highest surface over the middle of each cell, row 0 at the lowest y; NaN without any.

    Args:
        low, high: (2,) corners of the grid; cell: metres.
    """
    xs, ys = (np.arange(a + cell / 2, b, cell) for a, b in zip(np.asarray(low), np.asarray(high), strict=True))
    grid = np.stack(np.meshgrid(xs, ys), -1).reshape(-1, 2)
    return Rays(vertices, triangles).height(grid).reshape(len(ys), len(xs))
