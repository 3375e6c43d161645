"""From relative motions of pairs to poses of all: connected parts, a spanning tree, a robust pose graph.

Parameters of a pose are a twist (v, w) on its camera side: T exp(d). All costs are linear in the number of edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from realsim.core.geometry import invert_T
from realsim.core.least_squares import cauchy, least_squares
from realsim.core.meshes import linked, members
from realsim.core.types import F64

ITERATIONS = 50
CAUCHY = 3.0
"""Residual, in standard deviations, at which an edge has lost half its weight."""


@dataclass(frozen=True)
class Edge:
    """A measured motion: points of camera j into camera i."""

    i: int
    j: int
    T_i_j: F64
    """(4, 4)."""
    weight: float
    """Its weight, usually the number of matches that agree."""
    root: F64
    """(6, 6) whitening of the error (v, w) in metres and radians: a square root of its information."""


def whitening(sigma_m: float, sigma_rad: float) -> F64:
    """(6, 6) root for independent errors of translation and rotation."""
    return np.diag([1 / sigma_m] * 3 + [1 / sigma_rad] * 3)


def label_pieces(count: int, edges: Sequence[Edge]) -> NDArray[np.int64]:
    """(count,) number of the connected set that each node belongs to."""
    return linked([e.i for e in edges], [e.j for e in edges], count)


def components(count: int, edges: Sequence[Edge]) -> list[NDArray[np.int64]]:
    """Connected sets of nodes, the largest first; of two equally large ones the one with the lower index."""
    return members(label_pieces(count, edges))


def chain_poses(count: int, edges: Sequence[Edge], root: int = 0) -> F64:
    """(N, 4, 4) poses along the maximum spanning tree of weights, `root` at the identity; NaN where unreachable."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    T = np.full((count, 4, 4), np.nan)
    T[root] = np.eye(4)
    if not edges:
        return T
    i, j = np.array([(e.i, e.j) for e in edges]).T
    w = np.array([e.weight for e in edges])
    # One entry a pair, the heaviest; the cost 1/w keeps the tree's minimum where the weights are largest.
    best = {(min(e.i, e.j), max(e.i, e.j)): e for e in sorted(edges, key=lambda e: e.weight)}
    i, j = np.array(list(best)).T
    w = np.array([e.weight for e in best.values()])
    tree = minimum_spanning_tree(coo_matrix((1 / w, (i, j)), (count, count)))
    order, parent = breadth_first_order(tree, root, directed=False)
    for node in order[1:]:
        up = int(parent[node])
        e = best[min(node, up), max(node, up)]
        T[node] = T[up] @ (e.T_i_j if e.i == up else invert_T(e.T_i_j))
    return T


def optimise(T_world_camera: F64, edges: Sequence[Edge], anchor: int = 0, tolerance: float = 1e-8) -> tuple[F64, F64]:
    """Robust pose graph: ((N, 4, 4) poses, (E,) edge residuals in standard deviations). `anchor` stays where it is.
    Done where no pose moves by more than `tolerance` metres or radians.

    Gauss-Newton with Cauchy weights on the residual log(T_i_j^-1 T_i^-1 T_j) of an edge, its Jacobian to first order
    (exact where edges agree).
    """
    n, m = len(T_world_camera), len(edges)
    if n < 2 or not m:
        return np.array(T_world_camera, float), np.zeros(m)
    i, j = np.array([(e.i, e.j) for e in edges]).T
    Z_inv = invert_T(np.stack([e.T_i_j for e in edges]))
    root = np.stack([e.root for e in edges])
    row = 6 * np.arange(m)[:, None, None] + np.arange(6)[:, None]
    rows = np.broadcast_to(row, (m, 6, 12)).ravel()
    columns = np.concatenate([6 * k[:, None, None] + np.arange(6) + np.zeros((6, 1), int) for k in (i, j)], 2).ravel()

    def model(T: F64) -> tuple[F64, Any]:
        r = (root @ log_se3(Z_inv @ invert_T(T[i]) @ T[j])[..., None])[..., 0]
        # d log(E) is +d_j, and -Ad(T_j^-1 T_i) d_i.
        J = np.concatenate([-root @ adjoint(invert_T(T[j]) @ T[i]), root], 2)
        return r.ravel(), csr_matrix((J.ravel(), (rows, columns)), (6 * m, 6 * n))

    found = least_squares(
        model,
        np.array(T_world_camera, float),
        move=lambda T, step: T @ exp_se3(step.reshape(n, 6)),
        loss=cauchy(CAUCHY, np.arange(6 * m) // 6),
        free=np.arange(6 * n) // 6 != anchor,
        damping=0,
        iterations=ITERATIONS,
        tolerance=tolerance,
    )
    assert found is not None  # no state of this model is impossible
    return found.state, np.linalg.norm(found.residual.reshape(m, 6), axis=1)


# ---------------------------------------------------------------- SE(3), stacked


def hat(w: F64) -> F64:
    """(..., 3) to the cross-product matrices (..., 3, 3)."""
    K = np.zeros((*w.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return K


def exp_se3(d: F64) -> F64:
    """(N, 6) steps (v, w) to (N, 4, 4): translation v, rotation exp(w). A retraction, not the group's exponential."""
    from scipy.spatial.transform import Rotation

    T = np.tile(np.eye(4), (len(d), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(d[:, 3:]).as_matrix()
    T[:, :3, 3] = d[:, :3]
    return T


def log_se3(T: F64) -> F64:
    """(N, 4, 4) to (N, 6), the inverse of `exp_se3`."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_rotvec()], 1)


def adjoint(T: F64) -> F64:
    """(N, 4, 4) to (N, 6, 6): T exp(d) = exp(Ad(T) d) T to first order, d = (v, w)."""
    A = np.zeros((len(T), 6, 6))
    R = T[:, :3, :3]
    A[:, :3, :3] = A[:, 3:, 3:] = R
    A[:, :3, 3:] = hat(T[:, :3, 3]) @ R
    return A
