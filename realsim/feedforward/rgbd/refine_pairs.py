"""Selects the frames to compare and their points on a common surface."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import View
from realsim.feedforward.rgbd.matching import MIN_AGREEMENT
from realsim.feedforward.rgbd.overlap import overlap

NEIGHBOURS = 8
"""After the first solution each frame is matched again with this many that share the most surface with it."""
MOST_COMPARED = 64
"""In a dense capture each view is compared with this many that may see the same, evenly over the sequence."""


def choose_pairs(views: Sequence[View], T_world_camera: F64, per_frame: int = 6) -> list[tuple[int, int]]:
    """Pairs i < j: neighbours in time, and per frame `per_frame` others that see the same surface.

    The others are spread from much overlap (well matched) to little (a long baseline, which is what tells scale), so
    the number of pairs is linear in the number of frames.
    """
    n = len(views)
    pairs = {(i, i + step) for step in (1, 2, 3) for i in range(n - step)}
    samples = [_coarse_points(v) for v in views]
    c = T_world_camera[:, :3, 3]
    reach = np.array([np.median(s[:, 2]) if len(s) else 0.0 for s in samples])
    for i in range(n):
        if not len(samples[i]):
            continue
        near = np.flatnonzero(np.linalg.norm(c - c[i], axis=1) < 1.5 * reach[i])
        near = near[near != i]
        facing = np.einsum("na,a->n", T_world_camera[near, :3, 2], T_world_camera[i, :3, 2]) > 0.3
        near = near[facing]
        near = near[np.unique(np.linspace(0, len(near) - 1, MOST_COMPARED).astype(int))] if len(near) else near
        seen = share_in_image(views, T_world_camera, i, near, samples[i])
        good = near[seen > 0.3][np.argsort(-seen[seen > 0.3], kind="stable")]
        for j in good[np.unique(np.linspace(0, len(good) - 1, per_frame).round().astype(int))] if len(good) else ():
            pairs.add((min(i, int(j)), max(i, int(j))))
    return sorted(pairs)


def choose_overlapping(views: Sequence[View], T: F64, count: int = NEIGHBOURS) -> list[tuple[int, int]]:
    """Pairs i < j for matching under guidance: for every view `count` of those that share most surface with it at
    estimated poses. With `choose_pairs` positions were 1.2 to 1.6 times as far off on two rendered captures of three.

    Near centres and like directions come first, so that the cost stays linear in the number of views.
    """
    from scipy.spatial import cKDTree

    place = np.concatenate([T[:, :3, 3] + 1.5 * T[:, :3, 2], 0.5 * T[:, :3, 3]], 1)
    _, near = cKDTree(place).query(place, k=min(len(views), 3 * count + 1))
    pairs = set()
    for i, row in enumerate(near):
        fits = [(overlap(views[i], views[j], invert_T(T[i]) @ T[j], 6), int(j)) for j in row if j != i]
        good = sorted(((-f.fraction, j) for f, j in fits if f.fraction > 0.1 and f.agreement > 0.5 * MIN_AGREEMENT))
        # Every other one of the ranking: the nearest views add little that the next do not.
        pairs |= {(min(i, j), max(i, j)) for _, j in [*good[:2], *good[2 : 2 * count - 2 : 2]]}
    return sorted(pairs)


def share_in_image(views: Sequence[View], T: F64, i: int, others: NDArray[np.int64], points: F64) -> F64:
    """Share of view i's points (M, 3) that fall into the image of each of the others."""
    world = points @ T[i, :3, :3].T + T[i, :3, 3]
    share = np.zeros(len(others))
    for k, j in enumerate(others):
        y = (world - T[j, :3, 3]) @ T[j, :3, :3]
        share[k] = views[j].camera.pixels(y, near=0.1)[2].mean()
    return share


def _coarse_points(view: View) -> F64:
    step = max(1, view.camera.width // 12)
    z = view.depth[step // 2 :: step, step // 2 :: step].astype(float)
    rays = view.camera.rays()[step // 2 :: step, step // 2 :: step]
    return (rays * z[..., None])[z > 0]


@dataclass(frozen=True)
class Surface:
    """Points of views i and the surface elements of views j that they should lie on. Camera frames, sensor depth."""

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    p: F64
    """(M, 3) points in camera i."""
    q: F64
    """(M, 3) points in camera j."""
    n: F64
    """(M, 3) unit normals at q, camera j."""

    @property
    def z(self) -> F64:
        """(M,) the larger of the two depths: it decides the noise."""
        return np.maximum(self.p[:, 2], self.q[:, 2])


def sample_surface(view: View, rng: np.random.Generator, count: int) -> tuple[F64, F64]:
    """`count` points and normals of a view, rare normal directions as often as common ones (Rusinkiewicz 2001).

    The floor fills most of an image, yet only the few side faces tell the horizontal position.
    """
    rows, cols = np.nonzero((view.normal**2).sum(-1) > 0.5)
    if not len(rows):
        return np.zeros((0, 3)), np.zeros((0, 3))
    normals = view.normal[rows, cols].astype(float)
    bins = np.floor((normals + 1) * 2.499).astype(int) @ np.array([1, 5, 25])
    _, which, size = np.unique(bins, return_inverse=True, return_counts=True)
    weight = 1 / np.sqrt(size[which.ravel()])
    pick = rng.choice(len(rows), min(count, len(rows)), replace=False, p=weight / weight.sum())
    pick.sort()
    r, c = rows[pick], cols[pick]
    cam = view.camera
    z = view.depth[r, c].astype(float)
    points = np.column_stack([(c - cam.cx) / cam.fx * z, (r - cam.cy) / cam.fy * z, z])
    return points, normals[pick]


def associate(
    views: Sequence[View],
    samples: Sequence[tuple[F64, F64]],
    T_world_camera: F64,
    gain: float,
    pairs: Sequence[tuple[int, int]],
    gate: float,
) -> Surface:
    """Projective association: sample points of i onto the grid of j, kept where depth (within `gate` metres) and
    normals (within 30 degrees) agree and neither is seen at a grazing angle."""
    none = np.zeros(0, int)
    found: list[tuple[Any, ...]] = [(none, none, *np.zeros((3, 0, 3)))]
    for i, j in pairs:
        p, n_i = samples[i]
        if not len(p):
            continue
        Ti, Tj, view = T_world_camera[i], T_world_camera[j], views[j]
        R = Tj[:3, :3].T @ Ti[:3, :3]
        y = gain * p @ R.T + Tj[:3, :3].T @ (Ti[:3, 3] - Tj[:3, 3])
        q, n, ok = look_up(view, y)
        ok &= np.abs(y[:, 2] - gain * q[:, 2]) < gate
        ok &= np.einsum("mk,mk->m", n, n_i @ R.T) > 0.87
        ray = q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-9)
        ok &= -np.einsum("mk,mk->m", n, ray) > 0.3
        m = int(ok.sum())
        found.append((np.full(m, i), np.full(m, j), p[ok], q[ok], n[ok]))
    return Surface(*(np.concatenate(part) for part in zip(*found, strict=True)))


def look_up(view: View, y: F64) -> tuple[F64, F64, NDArray[np.bool_]]:
    """What view has where points y (M, 3) of its own camera frame project: points, normals, whether there is one."""
    cam = view.camera
    r, c, ok = cam.pixels(y, near=0.1)
    d = view.depth[r, c].astype(float)
    n = view.normal[r, c].astype(float)
    q = np.column_stack([(c - cam.cx) / cam.fx * d, (r - cam.cy) / cam.fy * d, d])
    return q, n, ok & (d > 0) & ((n**2).sum(1) > 0.5)
