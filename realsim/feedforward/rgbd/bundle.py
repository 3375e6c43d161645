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
    cauchy: float = 2.0,
    anchor: int = 0,
) -> Adjusted:
    """Levenberg-Marquardt with Cauchy weights (scale `cauchy` standard deviations); camera `anchor` does not move."""
    T, X = np.array(T_world_camera, float), np.array(points, float)
    damping, done = 1e-4, 0
    r, J_camera, J_point = linearise(T, X, seen)
    cost = _cost(r, cauchy)
    while done < iterations:
        done += 1
        w = weights(r, cauchy)
        accepted = False
        for _ in range(6):
            dT, dX = _step(J_camera, J_point, r, w, seen, len(T), len(X), damping, anchor)
            T1, X1 = T @ exp_se3(dT), X + dX
            r1, *J1 = linearise(T1, X1, seen)
            cost1 = _cost(r1, cauchy)
            if cost1 < cost:
                accepted = True
                break
            damping *= 10
        if not accepted:
            break
        gain = (cost - cost1) / cost
        T, X, r, cost, (J_camera, J_point) = T1, X1, r1, cost1, J1
        damping = max(damping / 10, 1e-9)
        if gain < 1e-6:
            break
    return Adjusted(T, X, r, cost, done)


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


def _squares(r: F64) -> F64:
    """(M, 2) squared residual of the image position and of the depth: they fail apart, at edges and in mismatches."""
    return np.stack([r[:, 0] ** 2 + r[:, 1] ** 2, r[:, 2] ** 2], 1)


def _cost(r: F64, c: float) -> float:
    return float(c**2 * np.log1p(_squares(r) / c**2).sum())


def weights(r: F64, c: float) -> F64:
    """(M, 3) Cauchy weights of the residuals."""
    w = 1 / (1 + _squares(r) / c**2)
    return w[:, [0, 0, 1]]


def _step(
    Jc: F64, Jp: F64, r: F64, w: F64, seen: Observations, cameras: int, points: int, damping: float, anchor: int
) -> tuple[F64, F64]:
    """Damped normal equations, the points eliminated: ((N, 6), (P, 3))."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    Wc, Wp = np.swapaxes(Jc * w[..., None], 1, 2), np.swapaxes(Jp * w[..., None], 1, 2)
    U = gather(Wc @ Jc, seen.camera, cameras)
    V = gather(Wp @ Jp, seen.point, points)
    gc = gather((Wc @ r[..., None])[..., 0], seen.camera, cameras)
    gp = gather((Wp @ r[..., None])[..., 0], seen.point, points)
    for D in (U, V):
        k = np.arange(D.shape[1])
        D[:, k, k] *= 1 + damping
        D[:, k, k] += 1e-9
    # V = L L'; with B = W L^-T the reduced matrix is U - B B', and B' is the only large sparse product.
    L_inv = np.linalg.inv(np.linalg.cholesky(V))
    B = _blocks(Wc @ Jp @ np.swapaxes(L_inv, 1, 2)[seen.point], seen.camera, seen.point, (cameras, points))
    y = (L_inv @ gp[..., None])[..., 0]
    S = _blocks(U, np.arange(cameras), np.arange(cameras), (cameras, cameras)) - B @ B.T
    free = np.flatnonzero(np.arange(6 * cameras) // 6 != anchor)
    dc = np.zeros(6 * cameras)
    dc[free] = -splu(csc_matrix(S)[free][:, free]).solve((gc.ravel() - B @ y.ravel())[free])
    dp = -(np.swapaxes(L_inv, 1, 2) @ (y + (B.T @ dc).reshape(points, 3))[..., None])[..., 0]
    return dc.reshape(cameras, 6), dp


def gather(values: F64, index: NDArray[np.int64], count: int) -> F64:
    """Sums of `values` (M, ...) that share an index, (count, ...)."""
    from scipy.sparse import csr_matrix

    select = csr_matrix((np.ones(len(index)), (index, np.arange(len(index)))), (count, len(index)))
    return (select @ values.reshape(len(index), -1)).reshape(count, *values.shape[1:])


def _blocks(values: F64, row: NDArray[np.int64], col: NDArray[np.int64], shape: tuple[int, int]) -> Any:
    """Sparse matrix of the dense blocks `values` (M, a, b) at block positions (row, col)."""
    from scipy.sparse import csr_matrix

    m, a, b = values.shape
    rows = np.broadcast_to((a * row[:, None, None] + np.arange(a)[:, None]), (m, a, b))
    cols = np.broadcast_to((b * col[:, None, None] + np.arange(b)), (m, a, b))
    return csr_matrix((values.ravel(), (rows.ravel(), cols.ravel())), (a * shape[0], b * shape[1]))
