"""Poses of views that follow an adjustment: each on its own, against points that stand.

A camera point (X, Y, Z) is measured as (X/Z, Y/Z, 1/Z): pixel and disparity of a stereo sensor, whose noise is the
same at every distance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from realsim.core.geometry import invert_T
from realsim.core.least_squares import cauchy, least_squares
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import Tracks, View
from realsim.feedforward.rgbd.matching import match_guided
from realsim.feedforward.rgbd.pose_graph import exp_se3, hat

NEAREST = 4
"""Each view is matched with this many adjusted ones."""
LEAST = 30
"""With fewer features that meet known points a view stays where it started."""
ITERATIONS = 10
CAUCHY = 2.0
"""Standard deviations at which a measurement has lost half its weight."""
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
    T, n = np.array(starts, float), len(views)
    camera, feature, point = _sightings(views, T, landmarks)
    X = landmarks.points[point]
    at = np.cumsum([0] + [len(v.z) for v in views])[camera] + feature
    xy = np.concatenate([v.xy for v in views])[at]
    z = np.concatenate([v.z for v in views])[at] * landmarks.gain
    measured = np.column_stack([xy, 1 / z])
    sigma_xy = SIGMA_PX / np.array([v.focal for v in views])[camera]
    sigma = np.stack([sigma_xy, sigma_xy, np.full_like(sigma_xy, SIGMA_INVERSE)], 1)
    columns = np.repeat(6 * camera[:, None] + np.arange(6), 3, axis=0).ravel()

    def model(T: F64) -> tuple[F64, Any]:
        P = ((X - T[camera, :3, 3])[:, None] @ T[camera, :3, :3])[:, 0]
        q = 1 / np.maximum(P[:, 2], 1e-3)
        predicted = np.stack([P[:, 0] * q, P[:, 1] * q, q], 1)
        J = np.zeros((len(P), 3, 3))
        J[:, 0, 0] = J[:, 1, 1] = q
        J[:, :, 2] = -predicted * q[:, None]
        J /= sigma[..., None]
        # With T exp(v, w) a camera point P becomes P - v + P x w.
        data = np.concatenate([-J, J @ hat(P)], 2).ravel()
        rows = csr_matrix((data, columns, np.arange(0, data.size + 1, 6)), (3 * len(P), 6 * n))
        return ((predicted - measured) / sigma).ravel(), rows

    known = (np.inf, np.inf) if prior is None else prior
    enough = np.bincount(camera, minlength=n) >= LEAST
    found = least_squares(
        model,
        T,
        move=lambda T, step: T @ exp_se3(step.reshape(n, 6)),
        # Image position and depth of one feature fail apart, at edges and in mismatches.
        loss=cauchy(CAUCHY, (2 * np.arange(len(X))[:, None] + (0, 0, 1)).ravel()),
        # The prior's error is the way moved so far: steps are small enough to add up.
        prior=(np.zeros(6 * n), np.tile(np.repeat(known, 3), n)),
        free=np.repeat(enough, 6),
        damping=0,
        iterations=ITERATIONS,
        tolerance=1e-6,
    )
    assert found is not None  # no state of this model is impossible
    metres = np.abs(found.residual[2::3]) * SIGMA_INVERSE * z**2 / landmarks.gain
    residual = np.full(n, np.nan)
    for k in np.flatnonzero(enough):
        residual[k] = 1.4826 * np.median(metres[camera == k])
    return found.state, residual


def _sightings(views: Sequence[View], T: F64, landmarks: Landmarks) -> NDArray[np.int64]:
    """(3, K): views, their features, and the tracks' points that these match."""
    from scipy.spatial import cKDTree

    known = list(landmarks.views)
    point_of, start = landmarks.tracks.of_features(known)
    centres = landmarks.T_world_camera

    def place(T: F64) -> F64:
        """Near in place and direction: the same measure for both, the scene being one to two metres away."""
        return np.concatenate([T[:, :3, 3], T[:, :3, 3] + 1.5 * T[:, :3, 2]], 1)

    near = cKDTree(place(centres)).query(place(T), k=min(NEAREST, len(known)))[1].reshape(len(views), -1)
    rows = [np.zeros((0, 3), np.int64)]
    for k in track(range(len(views)), "following views"):
        for j in near[k]:
            # The sensor's own metres on both sides: the motion has to be in them as well.
            motion = invert_T(centres[j]) @ T[k]
            motion[:3, 3] /= landmarks.gain
            found = match_guided([known[j], views[k]], 0, 1, motion)
            if found is not None:
                p = point_of[start[j] + found.a]
                rows.append(np.column_stack([np.full(len(p), k), found.b, p])[p >= 0])
    # One feature may meet its point through several views: once is enough.
    return np.unique(np.concatenate(rows), axis=0).T
