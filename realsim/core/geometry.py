"""Small geometry that every stage shares: rigid transforms, planes, pixels and points.

Conventions (docs/conventions.md): column vectors, `T_a_b` maps points of frame b into frame a, camera axes are
OpenCV's (x right, y down, z forward), the centre of the first pixel is (0, 0), quaternions are w x y z.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def is_rotation(R: ArrayLike, tol: float = 1e-6) -> bool:
    """Whether a 3x3 matrix is orthonormal with determinant +1 to within `tol`."""
    R = np.asarray(R, float)
    return bool(np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < tol and np.linalg.det(R) > 0)


def nearest_rotation(M: ArrayLike) -> Array:
    """The rotations nearest to matrices (..., 3, 3) in the Frobenius norm (orthogonal Procrustes; Schönemann 1966)."""
    U, _, Vt = np.linalg.svd(np.asarray(M, float))
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


def make_T(R: ArrayLike | None = None, t: ArrayLike | None = None) -> Array:
    """4x4 transform from a 3x3 rotation (identity if None) and a translation (zero if None)."""
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if t is not None:
        T[:3, 3] = t
    return T


def invert_T(T: ArrayLike) -> Array:
    """Inverse of a rigid 4x4 transform, or of a stack (..., 4, 4) of them."""
    T = np.asarray(T, float)
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def transform(T: ArrayLike, points: ArrayLike) -> Array:
    """Apply a 4x4 transform to points (..., 3); a similarity is allowed."""
    T = np.asarray(T, float)
    return np.asarray(points) @ T[:3, :3].T + T[:3, 3]


def cross(a: NDArray[Any], b: NDArray[Any]) -> Array:
    """(N, 3) what `np.cross` calculates of (N, 3) or (3,), without its handling of axes: it is called tens of thousands
    of times for few."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def exp_so3(w: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector (3,) in radians (Rodrigues)."""
    w = np.asarray(w, float)
    a = float(np.linalg.norm(w))
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if a < 1e-8:
        return nearest_rotation(np.eye(3) + K + 0.5 * K @ K)
    return np.eye(3) + np.sin(a) / a * K + (1 - np.cos(a)) / a**2 * K @ K


def interpolated_T(times: Array, T: Array, at: Array) -> Array:
    """(M, 4, 4) poses at times (M,) within those of samples (N >= 2, 4, 4): positions linearly, rotations along the
    shortest arc (slerp, Shoemake 1985)."""
    from scipy.spatial.transform import Rotation, Slerp

    out: Array = np.tile(np.eye(4), (len(at), 1, 1))
    out[:, :3, :3] = Slerp(times, Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix()
    out[:, :3, 3] = np.stack([np.interp(at, times, along) for along in T[:, :3, 3].T], 1)
    return out


def angle_deg(R: ArrayLike) -> float:
    """Angle of a rotation matrix in degrees."""
    # |R - 1| = 2 sqrt(2) sin(angle / 2) in the Frobenius norm: unlike the trace it is exact about zero.
    return float(np.degrees(2 * np.arcsin(min(np.linalg.norm(np.asarray(R, float) - np.eye(3)) / np.sqrt(8), 1))))


def quat_to_R(q: ArrayLike) -> Array:
    """Rotation matrix of a quaternion w x y z (normalised here)."""
    w, x, y, z = np.asarray(q, float) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def R_to_quat(R: ArrayLike) -> Array:
    """Unit quaternion w x y z with w >= 0 of a rotation matrix (Shepperd 1978: divide by the largest component)."""
    M = np.asarray(R, float)
    trace = float(np.trace(M))
    # 4 q q^T: its diagonal is 4 w^2, 4 x^2, 4 y^2, 4 z^2, and every row is q times its own component.
    outer = np.zeros((4, 4))
    outer[0, 1:] = outer[1:, 0] = M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]
    outer[1:, 1:] = M + M.T + (1 - trace) * np.eye(3)
    outer[0, 0] = 1 + trace
    q = outer[np.argmax(np.diag(outer))]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def fit_plane(points: ArrayLike, weights: ArrayLike | None = None) -> tuple[Array, float, float]:
    """Least-squares plane by PCA: unit normal n (3,), offset d with n·x + d = 0, RMS distance.

    Args:
        points: (M, 3), M >= 3.
        weights: (M,), non-negative; equal if None.
    """
    P = np.asarray(points, float)
    w = np.ones(len(P)) if weights is None else np.asarray(weights, float)
    c = (w[:, None] * P).sum(0) / w.sum()
    X = P - c
    values, vectors = np.linalg.eigh((X * w[:, None]).T @ X / w.sum())
    n = vectors[:, 0]
    return n, float(-n @ c), float(np.sqrt(max(values[0], 0.0)))


def pixel_rays(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> NDArray[np.float32]:
    """Directions (height, width, 3) with z = 1 in the camera frame through the pixel centres."""
    u = (np.arange(width, dtype=np.float32) - np.float32(cx)) / np.float32(fx)
    v = (np.arange(height, dtype=np.float32) - np.float32(cy)) / np.float32(fy)
    rays = np.ones((height, width, 3), np.float32)
    rays[..., 0] = u[None, :]
    rays[..., 1] = v[:, None]
    return rays


def outside_hull(corners: Array, xy: Array) -> Array:
    """(M,) distance of points (M, 2) from the convex hull of corners (K, 2), 0 inside it.

    The corners must not lie on one line.
    """
    from scipy.spatial import ConvexHull

    a = corners[ConvexHull(corners).vertices]  # counter-clockwise
    edge = np.roll(a, -1, 0) - a
    to = xy[:, None, :] - a
    inside = (edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0] >= 0).all(1)
    t = np.clip((to * edge).sum(2) / (edge**2).sum(1), 0, 1)
    return np.where(inside, 0.0, np.linalg.norm(to - t[..., None] * edge, axis=2).min(1))


def error_grid(contact_map: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, columns) signed error in metres of (N, 3) x, y, error; the worst of a cell; NaN where nothing was probed.

    The first row is the largest y, so that the picture is seen from above with x to the right.
    """
    from scipy import ndimage

    xy, error = contact_map[:, :2], contact_map[:, 2]
    low, size = xy.min(0), np.maximum(np.ptp(xy, axis=0), 1e-6)
    # A little wider than the probes are apart: few cells without one.
    cell = 1.15 * float(np.sqrt(size.prod() / len(xy)))
    shape = np.maximum((size / cell).astype(int), 1)
    column, row = np.minimum((xy - low) / size * shape, shape - 1).astype(int).T
    grid = np.full((shape[1], shape[0]), np.nan)
    order = np.argsort(np.abs(np.nan_to_num(error)), kind="stable")
    order = order[np.isfinite(error[order])]
    grid[row[order], column[order]] = error[order]
    empty = np.ones(grid.shape, bool)
    empty[row, column] = False
    # Probes stand at random, so that some cells have none: they show what their neighbour has.
    near = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    return grid[near[0], near[1]][::-1]
