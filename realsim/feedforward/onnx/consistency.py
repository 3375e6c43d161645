"""What of a prediction is believed: pixels that are sure enough and lie between no two surfaces, and views that others
confirm. A model places every view; only overlap shows that it belongs there."""

import numpy as np

from realsim.core.meshes import linked, members
from realsim.core.types import F32, F64, Bool, Intrinsics

EDGE = 0.03
"""Relative bend of inverse depth over three pixels that is an edge. On a plane inverse depth is linear in the image, so
a plane bends nowhere, however slanted it is seen."""
SAMPLES = 400
TOLERANCE = 0.1
"""Relative difference of depth at which two views still show the same surface."""
OVERLAP = 0.05
"""Share of a view's points that another view has to confirm."""


def agreement(depth: F32, mask: Bool, K: F64, T: F64) -> F64:
    """(N, N): the share of view i's points that view j confirms: inside its image, at the depth that it has there."""
    n, _, w = depth.shape
    out = np.zeros((n, n))
    for i in range(n):
        at = np.flatnonzero(mask[i])
        if not len(at) or not np.isfinite(T[i]).all():
            continue
        at = at[np.linspace(0, len(at) - 1, min(SAMPLES, len(at))).astype(int)]
        r, c = np.divmod(at, w)
        z = depth[i, r, c].astype(float)
        own = np.column_stack([(c - K[i, 0, 2]) / K[i, 0, 0] * z, (r - K[i, 1, 2]) / K[i, 1, 1] * z, z])
        world = own @ T[i, :3, :3].T + T[i, :3, 3]
        for j in range(n):
            if j != i and np.isfinite(T[j]).all():
                out[i, j] = _confirmed((world - T[j, :3, 3]) @ T[j, :3, :3], depth[j], mask[j], K[j])
    return out


def _confirmed(p: F64, depth: F32, mask: Bool, K: F64) -> float:
    h, w = depth.shape
    r, c, inside = Intrinsics(w, h, K[0, 0], K[1, 1], K[0, 2], K[1, 2]).pixels(p)
    same = inside & mask[r, c] & (np.abs(depth[r, c] - p[:, 2]) < TOLERANCE * p[:, 2])
    return float(same.sum()) / len(p)


def connected(share: F64) -> list[np.ndarray]:
    """Groups of views that hang together by overlap, the largest first; of equal ones that with the lower index."""
    one, other = np.nonzero(share > OVERLAP)
    return members(linked(one, other, len(share)))


def believed(depth: F32, conf: F32, mask: Bool, min_confidence: float, drop_percent: float) -> Bool:
    """(H, W) of one view: valid, at least `min_confidence`, not among the `drop_percent` least sure, off the edges.

    The limit by percentile is that of this view: a model is more or less sure of whole views, and a limit over all of
    them would empty some.
    """
    keep = mask & np.isfinite(depth) & (depth > 0) & (conf >= min_confidence)
    if drop_percent > 0 and keep.any():
        keep &= conf >= np.percentile(conf[keep], drop_percent)
    return keep & ~edges(depth, mask)


def edges(depth: F32, mask: Bool) -> Bool:
    """Pixels next to a step of depth (flying pixels lie there), and those beside what is not valid at all."""
    valid = mask & np.isfinite(depth) & (depth > 0)
    q = np.divide(1, depth, out=np.zeros_like(depth), where=valid)
    out = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        v, ok, hit = (np.moveaxis(a, axis, 0) for a in (q, valid, out))
        bend = np.abs(v[2:] - 2 * v[1:-1] + v[:-2])
        step = ok[2:] & ok[1:-1] & ok[:-2] & (bend > EDGE * v[1:-1])
        for shifted in (hit[2:], hit[1:-1], hit[:-2]):
            shifted |= step
    return out
