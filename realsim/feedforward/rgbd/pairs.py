"""Which frames to compare, and how two are brought together: by features, or by shape where colour is silent."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from realsim.feedforward.rgbd.graph import Edge, whitening
from realsim.feedforward.rgbd.overlap import overlap, register
from realsim.feedforward.rgbd.tracks import Match, View, match, rigid_ransac
from realsim.geometry import invert_T, transform
from realsim.types import F64

WINDOW = 4
"""Each frame is compared with so many that follow it."""
RECALLED = 4
"""And with so many that look alike, wherever they are in the sequence."""
ALL_PAIRS = 16
"""Up to so many frames, everything is compared with everything."""
WORDS = 512
"""Size of the visual vocabulary."""
MIN_OVERLAP, MIN_AGREEMENT = 0.06, 0.8
"""What two depth images must share, and how little they may contradict each other, for a pair to be believed."""
SHAPE_CORRELATION = 100.0
"""Neighbouring depth pixels err together: so many of them count as one independent measurement."""

Pair = tuple[int, int]


def candidates(views: Sequence[View], seed: int) -> list[Pair]:
    """Pairs i < j worth a comparison: neighbours in the sequence and look-alikes. Linear in the number of views."""
    n = len(views)
    if n <= ALL_PAIRS:
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(i + 1 + WINDOW, n))}
    return sorted(pairs | set(_lookalikes(views, seed)))


def _lookalikes(views: Sequence[View], seed: int) -> Iterable[Pair]:
    """Pairs outside the window with the most similar bags of visual words (Sivic and Zisserman 2003)."""
    counts = [len(v.descriptors) for v in views]
    if sum(counts) < 4 * WORDS:
        return
    rng = np.random.default_rng(seed)
    D = np.concatenate([v.descriptors[:: max(1, c // 200)] for v, c in zip(views, counts, strict=True) if c])
    words = D[rng.choice(len(D), WORDS, replace=False)]
    for _ in range(5):  # spherical k-means: enough for a ranking, which verification follows
        label = (D @ words.T).argmax(1)
        sums = np.zeros_like(words)
        np.add.at(sums, label, D)
        words = np.where(np.bincount(label, minlength=WORDS)[:, None] > 0, sums, words)
        words /= np.linalg.norm(words, axis=1, keepdims=True)
    bags = np.stack([np.bincount((v.descriptors @ words.T).argmax(1), minlength=WORDS) for v in views]).astype(float)
    bags *= np.log(len(views) / np.maximum((bags > 0).sum(0), 1))
    bags /= np.maximum(np.linalg.norm(bags, axis=1, keepdims=True), 1e-12)
    for i, bag in enumerate(bags):
        likeness = bags @ bag
        likeness[max(0, i - WINDOW) : i + WINDOW + 1] = -1
        for j in np.argsort(-likeness, kind="stable")[:RECALLED]:
            if likeness[j] > 0:
                yield min(i, int(j)), max(i, int(j))


def by_features(views: Sequence[View], i: int, j: int, seed: int) -> tuple[Edge, Match] | None:
    """The motion that the features of a pair agree on, if the depth images do not contradict it."""
    found = match(views, i, j, seed)
    if found is None or not believable(views, found):
        return None
    n = len(found.a)
    # A match is off by a centimetre or so, and matches of one pair err together: hence no better than a tenth.
    spread = max(1 / np.sqrt(n), 0.1)
    return Edge(i, j, found.T_i_j, float(n), whitening(0.02 * spread, 0.01 * spread)), found


def believable(views: Sequence[View], found: Match) -> bool:
    """Whether the depth images of a pair fit at its motion."""
    fit = overlap(views[found.i], views[found.j], found.T_i_j)
    return fit.fraction > MIN_OVERLAP and fit.agreement > MIN_AGREEMENT


def guided(views: Sequence[View], i: int, j: int, T_i_j: F64, radius_px: float = 6.0) -> Match | None:
    """Matches of a pair whose motion is nearly known: the most alike within `radius_px` of where a feature must be.

    Finds more than blind matching, and repeated texture cannot mislead it beyond the radius.
    """
    from scipy.spatial import cKDTree

    A, B = views[i], views[j]
    P = transform(invert_T(T_i_j), A.points)
    front = np.flatnonzero(P[:, 2] > 0.05)
    if len(front) < 12 or len(B.z) < 12:
        return None
    radius = radius_px / B.focal
    near, which = cKDTree(B.xy).query(P[front, :2] / P[front, 2:], k=6, distance_upper_bound=radius)
    real = np.isfinite(near)
    which = np.where(real, which, 0)
    # Depth must agree too: a feature behind another surface is hidden, not seen there.
    real &= np.abs(1 / P[front, 2][:, None] - 1 / B.z[which]) < 0.02
    likeness = np.where(real, np.einsum("kd,kmd->km", A.descriptors[front], B.descriptors[which]), -1)
    rows = np.arange(len(front))
    best = likeness.argmax(1)
    top = likeness[rows, best]
    likeness[rows, best] = -1
    b = which[rows, best]
    keep = np.flatnonzero((top > 0.75) & ((1 - top) < 0.9**2 * (1 - likeness.max(1))))
    a, b, top = front[keep], b[keep], top[keep]
    order = np.lexsort((a, -top, b))  # of several that claim one feature, the most alike
    first = np.ones(len(order), bool)
    first[1:] = b[order][1:] != b[order][:-1]
    chosen = np.sort(order[first])
    return Match(i, j, a[chosen], b[chosen], T_i_j) if len(chosen) >= 12 else None


# ---------------------------------------------------------------- by shape


def by_shape(views: Sequence[View], i: int, j: int, seed: int) -> Edge | None:
    """The motion that brings two depth images together: from rest, and from the shape features that they share.

    None where the images do not agree, or where what they share leaves the motion open (bare floor slides).
    """
    A, B = views[i], views[j]
    starts = [np.eye(4), *_shape_starts(A, B, np.random.default_rng((seed, i, j, 1)))]
    best: Edge | None = None
    for start in starts:
        T, information, rms = register(A, B, start)
        fit = overlap(A, B, T)
        if fit.fraction < 3 * MIN_OVERLAP or fit.agreement < MIN_AGREEMENT or not np.isfinite(rms):
            continue
        information = information / SHAPE_CORRELATION
        if np.linalg.eigvalsh(np.linalg.inv(information + 1e-9 * np.eye(6))).max() > 0.02**2:
            continue
        weight = 1e3 * fit.fraction * fit.agreement
        if best is None or weight > best.weight:
            best = Edge(i, j, T, weight, np.linalg.cholesky(information + 1e-9 * np.eye(6)).T)
    return best


def _shape_starts(A: View, B: View, rng: np.random.Generator) -> list[F64]:
    """A motion from matched FPFH descriptors (Rusu et al. 2009), if there is one."""
    clouds = [_shape_features(v) for v in (A, B)]
    (P, f), (Q, g) = clouds
    if min(len(P), len(Q)) < 50:
        return []
    from scipy.spatial import cKDTree

    ab, ba = cKDTree(g).query(f)[1], cKDTree(f).query(g)[1]
    a = np.flatnonzero(ba[ab] == np.arange(len(f)))
    if len(a) < 12:
        return []
    found = rigid_ransac(P[a], Q[ab[a]], rng, trials=4000)
    return [] if found is None else [found[0]]


def _shape_features(view: View, cell: float = 0.06) -> tuple[F64, F64]:
    """(M, 3) points about `cell` metres apart and their (M, 33) FPFH descriptors; flat surroundings are left out."""
    import open3d as o3d

    known = (view.depth > 0) & (np.abs(view.normal).sum(-1) > 0)
    cloud = o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector((view.camera.rays() * view.depth[..., None])[known].astype(float))
    cloud.normals = o3d.utility.Vector3dVector(view.normal[known].astype(float))
    cloud = cloud.voxel_down_sample(cell)
    cloud.normalize_normals()
    if len(cloud.points) < 50:
        return np.zeros((0, 3)), np.zeros((0, 33))
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * cell, max_nn=100)
    features = np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, near).data).T
    # A plane's descriptor is the commonest; what lies far from the mean tells places apart.
    unusual = np.linalg.norm(features - np.median(features, 0), axis=1)
    keep = unusual > np.median(unusual)
    return np.asarray(cloud.points)[keep], features[keep]
