"""Flights of stairs: level faces too narrow for a platform that rise one after another.

A tread is hardly deeper than a foot, so alone it is an obstacle like any other. What makes it a place to stand is the
flight: from the ground up, each face a step's height above the last and right beside it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from realsim.align.cloud import Cloud
from realsim.align.geometric import LEVEL_DEG, plane_of, smooth_regions

DEEP, WIDE = 0.15, 0.40
"""Metres: a tread's least depth (a foot and no more) and width (a person's)."""
FILLED = 0.6
"""Least share of its own rectangle that a tread fills."""
RISE = (0.08, 0.26)
"""Metres between a tread and the next. Building codes allow 10 to 22 cm."""
BESIDE = 0.12
"""Metres in the plan between a tread and the next: a nosing may hide so much of the lower one's back."""
LEAST = 3
"""Treads that make a flight; two may be anything."""


def treads(cloud: Cloud) -> list[NDArray[np.intp]]:
    """Indices of the points of each tread of the longest flight that begins at the ground, from below; empty if there
    is none. The cloud is levelled: z up, ground at z = 0."""
    up = cloud.normals[:, 2] if cloud.oriented else np.abs(cloud.normals[:, 2])
    level = np.flatnonzero((up > 0.9) & (cloud.points[:, 2] > RISE[0]))
    faces = [level[r] for r in smooth_regions(cloud.points[level], cloud.voxel, DEEP * WIDE * FILLED)]
    faces = [f for f in faces if _is_tread(cloud, f)]
    heights = np.array([np.median(cloud.points[f, 2]) for f in faces])
    best: dict[int, list[int]] = {}  # the longest flight that ends with each face
    for k in np.argsort(heights, kind="stable").tolist():
        below: list[list[int]] = [[]] if heights[k] < RISE[1] else []
        below += [
            best[j] for j in best if RISE[0] < heights[k] - heights[j] < RISE[1] and _beside(cloud, faces[j], faces[k])
        ]
        if below:
            best[k] = [*max(below, key=len), k]
    longest = max(best.values(), key=len, default=[])
    flight = [faces[k] for k in longest]
    return flight if len(flight) >= LEAST and _goes_on(cloud, flight) else []


def _is_tread(cloud: Cloud, face: NDArray[np.intp]) -> bool:
    import cv2

    points = cloud.points[face]
    slope, _ = plane_of(points)
    _, sides, _ = cv2.minAreaRect(points[:, :2].astype(np.float32))
    deep, wide = sorted(s + cloud.voxel for s in sides)
    seen = len(np.unique(np.floor(points[:, :2] / cloud.voxel).astype(np.int64) @ [1_000_003, 1])) * cloud.voxel**2
    level = np.degrees(np.arctan(np.hypot(*slope))) < LEVEL_DEG
    return bool(level and deep > DEEP and wide > WIDE and seen > FILLED * deep * wide)


def _beside(cloud: Cloud, a: NDArray[np.intp], b: NDArray[np.intp]) -> bool:
    from scipy.spatial import cKDTree

    return bool(cKDTree(cloud.points[a, :2]).query(cloud.points[b, :2])[0].min() < BESIDE)


def _goes_on(cloud: Cloud, faces: list[NDArray[np.intp]]) -> bool:
    """Whether the way up turns by less than 120 degrees at every tread: it may wind, but not go back and forth."""
    middles = np.array([cloud.points[f, :2].mean(0) for f in faces])
    steps = np.diff(middles, axis=0)
    return all(float(a @ b) > -0.5 * float(np.linalg.norm(a) * np.linalg.norm(b)) for a, b in pairwise(steps))
