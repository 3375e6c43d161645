"""A surface in patches that are planar: evenly spread points, grown together where one plane fits them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core import meshes
from realsim.core.types import F64

I64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Plane = tuple[F64, F64]  # a point and the normal
NEIGHBOURS = 12
ALIKE = 0.8  # least cosine between a point's normal and its patch's
LEAST = 5  # points: fewer are no patch
# Set by hand; tried on made rooms alone. Thin round legs are no planes: a rack with holes came out as 45 mm, so closed
# meshes are not asked (choose.py).
FLAT, PLACES = 0.3, 500  # metres about a place in which walls and floors are flat; vertices that are looked at
FITS = 3  # times a plane is fitted to what it took


@dataclass(frozen=True)
class Samples:
    """Points on a surface, at most one a cell of a grid and facing."""

    points: F64
    """(M, 3) metres."""
    normals: F64
    """(M, 3) unit, out of the surface."""
    area: F64
    """(M,) m^2 that each stands for."""
    spacing: float
    """Metres."""

    def where(self, keep: NDArray[Any]) -> Samples:
        """Those points only."""
        return Samples(self.points[keep], self.normals[keep], self.area[keep], self.spacing)


@dataclass(frozen=True)
class Patch:
    """Points on one plane, seen from its front."""

    index: I64
    """(P,) which of the samples."""
    origin: F64
    """(3,) a point of the plane."""
    axes: F64
    """(3, 3) rows u, v and the normal toward the front; u x v is the normal."""


def sampled(vertices: F64, triangles: NDArray[np.int32], spacing: float, seed: int = 0) -> Samples:
    """Points about `spacing` metres apart on all of a surface."""
    cross = meshes.across(vertices, triangles)
    twice = np.linalg.norm(cross, axis=1)
    total = float(twice.sum()) / 2
    count = max(int(4 * total / spacing**2), 100)
    points, chosen = meshes.sampled(vertices, triangles, count, np.random.default_rng(seed))
    normals = cross[chosen] / np.maximum(twice[chosen, None], 1e-15)
    cell = np.floor((points - points.min(0)) / spacing).astype(np.int64)
    axis = np.abs(normals).argmax(1)
    facing = 2 * axis + (normals[np.arange(count), axis] > 0)
    size = cell.max(0) + 1
    key = ((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]) * 6 + facing
    _, first, many = np.unique(key, return_index=True, return_counts=True)
    return Samples(points[first], normals[first], np.asarray(many * (total / count), np.float64), spacing)


def patches(samples: Samples, tolerance: float) -> list[Patch]:
    """Grow planes over the samples, the smoothest places first, until every point was tried.

    Args:
        tolerance: metres that a point may lie off its patch's plane.
    """
    from scipy.spatial import cKDTree

    P, N = samples.points, samples.normals
    if len(P) < LEAST:
        return []
    tree = cKDTree(P)
    reach = 2.5 * samples.spacing
    links = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix").tocsr()
    free = np.ones(len(P), bool)
    found = []
    for seed in np.argsort(_roughness(P, N, tree), kind="stable"):
        if not free[seed]:
            continue
        taken, plane = _grown(samples, free, links, int(seed), reach, tolerance)
        free[seed] = False
        if len(taken) < LEAST:
            continue
        free[taken] = False
        found.append(Patch(taken, plane[0], _axes(plane[1], P[taken] - plane[0])))
    return found


def noise_of(vertices: F64, seed: int = 0) -> float:
    """Metres that the vertices (V, 3) of a scan lie off planes: the RMS about the plane of what is within FLAT of a
    vertex, in the lower quartile of PLACES of them, because most of a place is flat; 0 where they are far apart."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    places = vertices[rng.choice(len(vertices), min(PLACES, len(vertices)), replace=False)]
    off = []
    for near in cKDTree(vertices).query_ball_point(places, FLAT):
        least = np.linalg.eigvalsh(np.cov(vertices[near].T))[0] if len(near) >= NEIGHBOURS else 0.0
        off.append(np.sqrt(max(least, 0.0)))
    return float(np.percentile(off, 25))


def _roughness(P: F64, N: F64, tree: object) -> F64:
    """(M,) how far from alike the normals around each point are."""
    _, near = tree.query(P, k=min(NEIGHBOURS, len(P)))  # type: ignore[attr-defined]
    return 1 - np.einsum("mki,mi->mk", N[near], N).mean(1)


def _grown(samples: Samples, free: Bool, links: Any, seed: int, reach: float, tolerance: float) -> tuple[I64, Plane]:
    """(indices, plane) of the connected free points about a seed that lie on its plane.

    The ball about the seed is doubled until nothing of the patch reaches its rim.
    """
    P, N, radius = samples.points, samples.normals, 3 * reach
    plane = (P[seed], N[seed])
    near = links.indices[links.indptr[seed] : links.indptr[seed + 1]]
    near = near[free[near]]
    near = near[N[near] @ N[seed] > ALIKE]
    if len(near) < LEAST:  # the rest of what others took
        return near[:0], plane
    plane = _fitted(P, N, near, plane)
    while True:
        taken = near[:0]
        for _ in range(FITS):
            on = _connected(samples, free, links, seed, radius, plane, tolerance)
            if not len(on):
                return taken, plane
            if np.array_equal(on, taken):
                break
            taken, plane = on, _fitted(P, N, on, plane)
        if np.linalg.norm(P[taken] - P[seed], axis=1).max() < radius - reach:
            return taken, plane
        radius *= 2


def _connected(
    samples: Samples, free: Bool, links: Any, seed: int, radius: float, plane: Plane, tolerance: float
) -> I64:
    """Free points in a ball about a seed that lie on a plane, and are linked to the seed by such; none if it does not
    lie there itself. Only they and their neighbours are looked at."""
    P, N, (point, normal) = samples.points, samples.normals, plane
    left, here, found = free.copy(), np.array([seed]), []
    while len(here):
        left[here] = False
        at = P[here]
        on = (((at - P[seed]) ** 2).sum(1) <= radius**2) & (np.abs((at - point) @ normal) < tolerance)
        here = here[on & (N[here] @ normal > ALIKE)]
        found.append(here)
        first = links.indptr[here]
        near = links.indices[meshes.runs(first, links.indptr[here + 1] - first)]
        here = np.unique(near[left[near]])
    return np.sort(np.concatenate(found))


def _fitted(P: F64, N: F64, index: I64, before: Plane) -> Plane:
    """The plane through points; through few, with the normal that they have."""
    if len(index) < LEAST:
        return before
    middle = P[index].mean(0)
    mean = N[index].mean(0)
    mean /= np.linalg.norm(mean)
    _, spread, rows = np.linalg.svd(P[index] - middle, full_matrices=False)
    # A thread of points has no plane of its own.
    normal = rows[2] if spread[1] > 0.3 * spread[0] or len(index) > 50 else mean
    normal = normal if normal @ mean > 0 else -normal
    return (middle, normal) if normal @ mean > ALIKE else (middle, mean)


def _axes(normal: F64, offsets: F64) -> F64:
    """Rows u, v, normal; u along the longest extent in the plane, level where the patch is upright."""
    flat = offsets - np.outer(offsets @ normal, normal)
    u = np.cross([0.0, 0.0, 1.0], normal)
    if np.linalg.norm(u) < 0.3:
        u = np.linalg.svd(flat, full_matrices=False)[2][0]
        u -= (u @ normal) * normal
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u), normal])
