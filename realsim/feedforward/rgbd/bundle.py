"""Bundle adjustment of feature tracks with depth: image residuals in pixels, depth residuals in inverse depth.

A camera point (X, Y, Z) is measured as (X/Z, Y/Z, 1/Z): pixel and disparity of a stereo sensor, whose noise is the
same at every distance. The points are eliminated by the Schur complement (Triggs et al. 2000, section 6); the rest is
sparse in the cameras, so that the cost is linear in the number of observations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from realsim.core.least_squares import Loss, cauchy, least_squares
from realsim.core.types import F64
from realsim.feedforward.rgbd.pose_graph import exp_se3, hat


@dataclass(frozen=True)
class Observations:
    """M measurements of P points by N cameras."""

    camera: NDArray[np.int64]
    """(M,) 0..N-1."""
    point: NDArray[np.int64]
    """(M,) 0..P-1."""
    measured: F64
    """(M, 3): x and y on the plane z = 1, and 1 / sensor depth (metres)."""
    sigma: F64
    """(M, 3) standard deviations; infinity where there is no such measurement."""


@dataclass(frozen=True)
class Adjusted:
    """The optimum, and how well it fits."""

    T_world_camera: F64
    """(N, 4, 4)."""
    points: F64
    """(P, 3) world."""
    residual: F64
    """(M, 3) in standard deviations."""
    cost: float
    iterations: int


def adjust(
    T_world_camera: F64,
    points: F64,
    seen: Observations,
    *,
    iterations: int = 15,
    scale: float = 2.0,
    anchor: int = 0,
) -> Adjusted:
    """Levenberg-Marquardt with Cauchy weights (`scale` standard deviations); camera `anchor` does not move."""
    n, p = len(T_world_camera), len(points)
    columns = np.concatenate(
        [6 * seen.camera[:, None] + np.arange(6), 6 * n + 3 * seen.point[:, None] + np.arange(3)], 1
    )
    columns = np.repeat(columns, 3, axis=0).ravel()
    start = 9 * np.arange(3 * len(seen.camera) + 1)

    def model(state: tuple[F64, F64]) -> tuple[F64, Any]:
        r, J_camera, J_point = linearise(*state, seen)
        J = np.concatenate([J_camera, J_point], 2)
        return r.ravel(), csr_matrix((J.ravel(), columns, start), (r.size, 6 * n + 3 * p))

    found = least_squares(
        model,
        (np.array(T_world_camera, float), np.array(points, float)),
        move=lambda s, step: (s[0] @ exp_se3(step[: 6 * n].reshape(n, 6)), s[1] + step[6 * n :].reshape(p, 3)),
        loss=loss(len(seen.camera), scale),
        free=np.arange(6 * n + 3 * p) // 6 != anchor,
        eliminated=3 * p,
        iterations=iterations,
    )
    assert found is not None  # no state of this model is impossible
    T, X = found.state
    return Adjusted(T, X, found.residual.reshape(-1, 3), found.cost, found.iterations)


def linearise(T: F64, X: F64, seen: Observations) -> tuple[F64, F64, F64]:
    """Whitened residuals (M, 3) and their Jacobians by camera twist (M, 3, 6) and point (M, 3, 3)."""
    R = T[seen.camera, :3, :3]
    P = ((X[seen.point] - T[seen.camera, :3, 3])[:, None] @ R)[:, 0]
    q = 1 / np.maximum(P[:, 2], 1e-3)
    predicted = np.stack([P[:, 0] * q, P[:, 1] * q, q], 1)
    J = np.zeros((len(P), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = q
    J[:, :, 2] = -predicted * q[:, None]
    J /= seen.sigma[..., None]
    # With T exp(v, w) a camera point P becomes P - v + P x w.
    J_camera = np.concatenate([-J, J @ hat(P)], 2)
    return (predicted - seen.measured) / seen.sigma, J_camera, J @ np.swapaxes(R, 1, 2)


def loss(observations: int, scale: float) -> Loss:
    """Cauchy's, of the image position and the depth of an observation each: they fail apart, at edges and in
    mismatches."""
    return cauchy(scale, (2 * np.arange(observations)[:, None] + (0, 0, 1)).ravel())
