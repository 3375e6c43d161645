"""Selects the pairs of frames to compare, and aligns them: by features, or by shape where there is no texture."""

from collections.abc import Iterable, Sequence

import numpy as np

from realsim.core.geometry import invert_T, make_T, transform
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import Match, View, match, rigid_ransac
from realsim.feedforward.rgbd.overlap import COARSE, FINE, Overlap, overlap, register
from realsim.feedforward.rgbd.pose_graph import Edge, whitening

WINDOW = 4
"""Each frame is compared with this many that follow it."""
RECALLED = 4
"""And with this many that look alike, anywhere in the sequence."""
ALL_PAIRS = 16
"""Up to this many frames, all pairs are compared."""
WORDS = 512
"""Size of the visual vocabulary."""
MIN_OVERLAP, MIN_AGREEMENT = 0.06, 0.85
"""Limits for a reliable pair: the overlap of two depth images, and their contradictions."""
LOOSE = 0.02
"""Standard deviation, metres or radians, beyond which a registration by shape slides."""

RIVAL_M = 0.3
"""Metres by which a registration by shape is shifted to see whether it falls into another place: a tread's depth. A
second shift of 0.45 m cost 12 of 38 true links of a corridor by shape alone and kept no false one out there; on one
rendered row (spacing 0.46 m, no colour) it met eight false ones, before a third frame was asked to confirm them."""
RIVAL, RIVAL_AGREEMENT = 0.7, 0.03
"""Share of a registration's weight from which another place counts that fits too, and how much less depth may agree
there. On rendered stairwells registration stops one or two treads off with 0.7 to 1.5 times the weight of the truth
and no contradiction; a room with three boxes contradicts a shift by 0.07."""

Pair = tuple[int, int]


def propose_pairs(views: Sequence[View], seed: int) -> list[Pair]:
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


def match_by_features(views: Sequence[View], i: int, j: int, seed: int) -> tuple[Match, Overlap] | None:
    """The motion that most features of a pair agree on, and how the depth images fit at it. None: too few features.

    The depth images are the judge (`is_believable`): features may all lie on something that moved between the frames.
    """
    found = match(views, i, j, seed)
    if found is None:
        return None
    fit = overlap(views[i], views[j], found.T_i_j)
    if not is_believable(fit):
        # Few matches close together leave the far end of the picture loose; surfaces can hold it, if it is true.
        found = tighten(views, found) or found
        fit = overlap(views[i], views[j], found.T_i_j)
    return found, fit


def is_believable(fit: Overlap) -> bool:
    """Whether two depth images fit together well enough to rely on it."""
    return fit.fraction > MIN_OVERLAP and fit.agreement > MIN_AGREEMENT


def make_edge(found: Match) -> Edge:
    """A pair's motion for the pose graph."""
    # A match is off by a centimetre or so, and matches of one pair err together: hence no better than a tenth.
    spread = max(1 / np.sqrt(len(found.a)), 0.1)
    return Edge(found.i, found.j, found.T_i_j, float(len(found.a)), whitening(0.02 * spread, 0.01 * spread))


def tighten(views: Sequence[View], found: Match) -> Match | None:
    """The same matches with the motion that they and the surfaces agree on; None if most matches must give way."""
    A, B = views[found.i], views[found.j]
    P, Q = A.points[found.a], B.points[found.b]
    T, _, _ = register(A, B, found.T_i_j, (0.2, *FINE), (P, Q))
    keep = np.linalg.norm(transform(T, Q) - P, axis=1) < 0.015 * np.minimum(P[:, 2], Q[:, 2]) + 0.015
    if keep.sum() < max(12, 0.6 * len(P)):
        return None
    return Match(found.i, found.j, found.a[keep], found.b[keep], T)


def match_guided(views: Sequence[View], i: int, j: int, T_i_j: F64, radius_px: float = 3.0) -> Match | None:
    """Matches of a pair whose motion is nearly known: the most alike within `radius_px` of where a feature must be.

    Finds more than blind matching, and repeated texture cannot mislead it beyond the radius. A wider radius joins
    neighbouring features into contradictory tracks: 6 pixels instead of 3 halves the tracks of a rendered capture.
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


def register_by_shape(
    views: Sequence[View], i: int, j: int, starts: Sequence[F64], reach: tuple[float, ...] = COARSE
) -> Edge | None:
    """The motion that brings two depth images together, the best from any of `starts`.

    None where the images do not agree, or where what they share leaves the motion open (bare floor slides).
    """
    A, B = views[i], views[j]
    best: Edge | None = None
    for start in starts:
        T, information, rms = register(A, B, start, reach)
        fit = overlap(A, B, T)
        if fit.fraction < 3 * MIN_OVERLAP or fit.agreement < MIN_AGREEMENT or not np.isfinite(rms):
            continue
        information = information + 1e-9 * np.eye(6)
        if np.linalg.eigvalsh(np.linalg.inv(information)).max() > LOOSE**2:
            continue
        weight = 1e3 * fit.fraction * fit.agreement
        if best is None or weight > best.weight:
            best = Edge(i, j, T, weight, np.asarray(np.linalg.cholesky(information).T, float))
    return best


def is_ambiguous(views: Sequence[View], edge: Edge) -> bool:
    """Whether two depth images fit in another place about as well: a step further on stairs, a stake further in a row.

    Registration starts anew from six shifted positions; one that ends elsewhere and fits is a rival.
    """
    A, B = views[edge.i], views[edge.j]
    least = overlap(A, B, edge.T_i_j).agreement - RIVAL_AGREEMENT
    for shift in RIVAL_M * np.vstack([np.eye(3), -np.eye(3)]):
        T, _, rms = register(A, B, make_T(None, shift) @ edge.T_i_j, (COARSE[0], COARSE[-2]))
        if not np.isfinite(rms) or np.linalg.norm(T[:3, 3] - edge.T_i_j[:3, 3]) < RIVAL_M / 3:
            continue
        fit = overlap(A, B, T)
        if fit.agreement > least and 1e3 * fit.fraction * fit.agreement > RIVAL * edge.weight:
            return True
    return False


def propose_starts(a: tuple[F64, F64], b: tuple[F64, F64], rng: np.random.Generator) -> list[F64]:
    """Motions to start from: rest, and that of matched `describe_shape` if enough of them agree."""
    from scipy.spatial import cKDTree

    (P, f), (Q, g) = a, b
    rest = [np.eye(4)]
    if min(len(P), len(Q)) < 50:
        return rest
    ab, ba = cKDTree(g).query(f)[1], cKDTree(f).query(g)[1]
    mutual = np.flatnonzero(ba[ab] == np.arange(len(f)))
    if len(mutual) < 12:
        return rest
    found = rigid_ransac(P[mutual], Q[ab[mutual]], rng, trials=2000)
    return rest if found is None else [*rest, found[0]]


def describe_shape(view: View, cell: float = 0.06) -> tuple[F64, F64]:
    """(M, 3) points about `cell` metres apart and their (M, 33) FPFH descriptors; flat surroundings are left out."""
    from realsim.core.open3d import o3d

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
