"""Do two depth images agree about the space between them? The judge of every pair, whatever proposed its motion."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from realsim.core.geometry import cross, invert_T, transform
from realsim.core.types import F64, Bool, Intrinsics
from realsim.feedforward.rgbd.features import View
from realsim.feedforward.rgbd.pose_graph import exp_se3, hat

TOLERANCE = 0.012
"""1/m: inverse depths that differ by less agree (1.2 cm at 1 m, 5 cm at 2 m: noise, slant and pose error together)."""


COARSE, FINE = (0.4, 0.2, 0.1, 0.05), (0.1, 0.05)
"""Metres at 1.5 m beyond which surfaces do not attract each other, for motions that are open and nearly known."""
ITERATIONS = 50
"""Steps at each reach: along a floor with little on it registration creeps."""


@dataclass(frozen=True)
class Overlap:
    """Of the points of one view that fall into the other's image, both ways together."""

    fraction: float
    """Share that lies on the surface that the other measured there: the surface both see."""
    agreement: float
    """Agreeing / (agreeing + impossible). Impossible: in front of a surface that the other saw through it."""


@dataclass(frozen=True)
class Landing:
    """Points of view B that fall on measured pixels of view A."""

    source: F64
    """(M, 3) points in camera B."""
    points: F64
    """(M, 3) the same in camera A."""
    depth: F64
    """(M,) what A measured there, metres."""
    pixel: tuple[np.ndarray, np.ndarray]
    """Row and column in A's thinned grid, (M,) each."""
    source_index: np.ndarray
    """(M,) flat pixel of B."""
    total: int
    """Points of B altogether."""


_rays = lru_cache(8)(Intrinsics.rays)
Seen = tuple[F64, np.ndarray]
"""(M, 3) points of a view, its camera's frame, and (M,) their flat pixels."""


def seen(view: View, stride: int) -> Seen:
    """Every `stride`-th row and column that has depth."""
    valid = np.zeros(view.depth.shape, bool)
    valid[::stride, ::stride] = view.depth[::stride, ::stride] > 0
    index = np.flatnonzero(valid)
    return _rays(view.camera).reshape(-1, 3)[index] * view.depth.ravel()[index, None].astype(float), index


def project_view(A: View, of_B: Seen, T_a_b: F64) -> Landing:
    """Project what B sees into A at the motion T_a_b (points of B into A)."""
    source, index = of_B
    points = transform(T_a_b, source)
    r, c, inside = A.camera.pixels(points, near=0.05)
    depth = A.depth[r, c].astype(float)
    keep = np.flatnonzero(inside & (depth > 0))
    return Landing(source[keep], points[keep], depth[keep], (r[keep], c[keep]), index[keep], len(index))


def overlap(A: View, B: View, T_a_b: F64, stride: int = 2) -> Overlap:
    """How well the two depth images fit at the motion T_a_b (points of B into A)."""
    total = agree = against = 0
    for X, Y, T in ((A, B, T_a_b), (B, A, invert_T(T_a_b))):
        landing = project_view(X, seen(Y, stride), T)
        difference = 1 / landing.points[:, 2] - 1 / landing.depth
        total += landing.total
        agree += int((np.abs(difference) < TOLERANCE).sum())
        against += int((difference > 2 * TOLERANCE).sum())
    return Overlap(agree / max(total, 1), agree / max(agree + against, 1))


def register(
    A: View,
    B: View,
    T_a_b: F64,
    reach: tuple[float, ...] = COARSE,
    ties: tuple[F64, F64] | None = None,
) -> tuple[F64, F64, float]:
    """Projective point-to-plane registration (Blais and Levine 1995; Chen and Medioni 1991), both ways.

    Args:
        T_a_b: (4, 4) start.
        reach: metres at 1.5 m beyond which surfaces do not attract each other, coarse to fine.
        ties: (M, 3) points in A and the same points in B, which hold the motion where surfaces slide.

    Returns:
        (4, 4) motion, (6, 6) information of its twist (v, w) on B's side, RMS distance in metres.
    """
    T, H, rms = np.array(T_a_b, float), np.zeros((6, 6)), np.inf
    for limit in reach:
        stride = 2 if limit > FINE[0] else 1
        both = seen(A, stride), seen(B, stride)
        for _ in range(ITERATIONS):
            rows = [_planes(A, B, *both, T, limit)]
            if ties is not None:
                rows.append(_ties(*ties, T))
            J, r, sigma = (np.concatenate(part) for part in zip(*rows, strict=True))
            if len(r) < 50:
                return T, np.zeros((6, 6)), np.inf
            w = 1 / (1 + (r / (2.5 * sigma)) ** 2) / sigma**2
            H = J.T @ (J * w[:, None])
            step: F64 = -np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(6), J.T @ (w * r))
            T = T @ exp_se3(step[None])[0]
            rms = float(np.sqrt((w * r**2).sum() / w.sum()))
            if np.abs(step).max() < (1e-4 if limit > FINE[0] else 2e-5):
                break
    return T, H, rms


def _planes(A: View, B: View, of_A: Seen, of_B: Seen, T: F64, limit: float) -> tuple[F64, F64, F64]:
    """Jacobian (M, 6) by B's twist, distances (M,) and their standard deviations (M,), metres."""
    J, r, sigma = [], [], []
    for X, Y, of_Y, T_x_y, own in ((A, B, of_B, T, True), (B, A, of_A, invert_T(T), False)):
        land_ = project_view(X, of_Y, T_x_y)
        n = X.normal[land_.pixel].astype(float)
        m = Y.normal.reshape(-1, 3)[land_.source_index] @ T_x_y[:3, :3].T
        rays = _rays(X.camera)[land_.pixel]
        d = _dot(land_.points - rays * land_.depth[:, None], n)
        ok: Bool = (np.abs(d) < limit * np.maximum(1, land_.depth / 1.5)) & (_dot(n, m) > 0.8)
        n, d, P, z = n[ok], d[ok], land_.source[ok], land_.depth[ok]
        if own:  # X = A: a point p of B moves with B's twist, dp = v + w x p.
            k = n @ T[:3, :3]
            J.append(np.concatenate([k, cross(P, k)], 1))
        else:  # X = B: a point of A seen from B moves the other way.
            k, p = -n, land_.points[ok]
            J.append(np.concatenate([k, cross(p, k)], 1))
        r.append(d)
        # Neighbouring depth pixels err together: each of the some thousands counts as a hundredth.
        sigma.append(10 * (0.002 * z**2 + 0.001))
    return np.concatenate(J), np.concatenate(r), np.concatenate(sigma)


def _dot(a: F64, b: F64) -> F64:
    """(M,) of rows (M, 3), to the bit as `(a * b).sum(1)`, which takes several times as long."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _ties(P: F64, Q: F64, T: F64) -> tuple[F64, F64, F64]:
    """The same for matched points P of A and Q of B: three rows a point."""
    R = T[:3, :3]
    # d(T exp(v, w) Q) = R (v + w x Q), and w x Q = -hat(Q) w.
    J = np.concatenate([np.broadcast_to(R, (len(Q), 3, 3)), -R @ hat(Q)], 2)
    sigma = np.repeat(0.004 * P[:, 2] ** 2 + 0.003, 3)
    return J.reshape(-1, 6), (transform(T, Q) - P).ravel(), sigma
