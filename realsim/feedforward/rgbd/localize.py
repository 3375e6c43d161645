"""Poses of views that follow an adjustment: each on its own, against points that stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from realsim.core.geometry import invert_T
from realsim.core.least_squares import least_squares
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.feedforward.rgbd.bundle import Observations, linearise, loss
from realsim.feedforward.rgbd.features import Tracks, View
from realsim.feedforward.rgbd.matching import match_guided
from realsim.feedforward.rgbd.pose_graph import exp_se3

NEAREST = 4
"""Each view is matched with this many adjusted ones."""
LEAST = 30
"""With fewer features that meet known points a view stays where it started."""
ITERATIONS = 10
CAUCHY = 2.0
"""Standard deviations, as in the adjustment."""
SIGMA_PX = 0.25
"""Localisation noise of features, pixels."""
SIGMA_INVERSE = 0.003
"""Noise of inverse depth, 1/m: 3 mm at 1 m, 12 mm at 2 m (range noise, quantisation and fixed pattern together)."""


@dataclass(frozen=True)
class Landmarks:
    """Result of an adjustment of N views."""

    views: Sequence[View]
    T_world_camera: F64
    """(N, 4, 4)."""
    tracks: Tracks
    points: F64
    """(P, 3) world, of the tracks."""
    gain: float = 1.0
    """World metres for a metre of sensor depth."""


def localize(
    views: Sequence[View], starts: F64, landmarks: Landmarks, prior: tuple[float, float] | None = None
) -> tuple[F64, F64]:
    """Poses of M views from the landmarks that they see.

    Args:
        starts: (M, 4, 4) poses that are right to a pixel or two.
        prior: standard deviations of position (metres) and angle (radians) of `starts`, if anything is known.

    Returns:
        (M, 4, 4) poses, and (M,) 1.4826 * median depth residual in metres of sensor depth, NaN where a view sees too
        few landmarks: it stays where it started.
    """
    T = np.array(starts, float)
    residual = np.full(len(views), np.nan)
    seen, points = _sightings(views, T, landmarks)
    enough = np.bincount(seen.camera, minlength=len(views)) >= LEAST
    n, rows = len(views), 3 * len(points)
    columns = np.repeat(6 * seen.camera[:, None] + np.arange(6), 3, axis=0).ravel()

    def model(T: F64) -> tuple[F64, Any]:
        r, J, _ = linearise(T, points, seen)
        return r.ravel(), csr_matrix((J.ravel(), columns, 6 * np.arange(rows + 1)), (rows, 6 * n))

    known = (np.inf, np.inf) if prior is None else prior
    found = least_squares(
        model,
        T,
        move=lambda T, step: T @ exp_se3(step.reshape(n, 6)),
        loss=loss(len(points), CAUCHY),
        # The prior's error is the way moved so far: steps are small enough to add up.
        prior=(np.zeros(6 * n), np.tile(np.repeat(known, 3), n)),
        free=np.repeat(enough, 6),
        damping=0,
        iterations=ITERATIONS,
        tolerance=1e-6,
    )
    assert found is not None  # no state of this model is impossible
    T, r = found.state, found.residual.reshape(-1, 3)
    metres = np.abs(r[:, 2]) * seen.sigma[:, 2] / seen.measured[:, 2] ** 2 / landmarks.gain
    for k in np.flatnonzero(enough):
        residual[k] = 1.4826 * np.median(metres[seen.camera == k])
    return T, residual


def _sightings(views: Sequence[View], T: F64, landmarks: Landmarks) -> tuple[Observations, F64]:
    """Features of the views that match a feature of a track, and the tracks' points (K, 3), one an observation."""
    from scipy.spatial import cKDTree

    known = list(landmarks.views)
    point_of, start = landmarks.tracks.of_features(known)
    centres = landmarks.T_world_camera
    # Near in place and direction: the same measure for both, the scene being one to two metres away.
    place = np.concatenate([centres[:, :3, 3], centres[:, :3, 3] + 1.5 * centres[:, :3, 2]], 1)
    own = np.concatenate([T[:, :3, 3], T[:, :3, 3] + 1.5 * T[:, :3, 2]], 1)
    near = cKDTree(place).query(own, k=min(NEAREST, len(known)))[1].reshape(len(views), -1)
    camera, point, feature = [], [], []
    for k in track(range(len(views)), "following views"):
        for j in near[k]:
            # The sensor's own metres on both sides: the motion has to be in them as well.
            motion = invert_T(centres[j]) @ T[k]
            motion[:3, 3] /= landmarks.gain
            found = match_guided([known[j], views[k]], 0, 1, motion)
            if found is None:
                continue
            p = point_of[start[j] + found.a]
            real = p >= 0
            camera.append(np.full(int(real.sum()), k))
            point.append(p[real])
            feature.append(found.b[real])
    if not camera:
        none: NDArray[np.int64] = np.zeros(0, np.int64)
        return Observations(none, none, np.zeros((0, 3)), np.ones((0, 3))), np.zeros((0, 3))
    # One feature may meet its point through several views: once is enough.
    rows = np.unique(np.column_stack([np.concatenate(part) for part in (camera, feature, point)]), axis=0)
    cam, feat, pnt = rows.T
    first = np.cumsum([0] + [len(v.z) for v in views])[cam] + feat
    xy = np.concatenate([v.xy for v in views])[first]
    z = np.concatenate([v.z for v in views])[first] * landmarks.gain
    sigma_xy = SIGMA_PX / np.array([v.focal for v in views])[cam]
    sigma = np.stack([sigma_xy, sigma_xy, np.full_like(sigma_xy, SIGMA_INVERSE)], 1)
    seen = Observations(cam, np.arange(len(cam)), np.column_stack([xy, 1 / z]), sigma)
    return seen, landmarks.points[pnt]
