"""Evidence of frames about each other: features with depth, verified matches between frames, tracks.

A `View` is a frame boiled down to what refinement needs (about 0.7 MB), so that images are read once.
Nothing here looks at given poses: matches that are verified by depth alone can therefore contradict them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import make_T, nearest_rotation, transform
from realsim.core.meshes import linked
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F32, F64, Bool, Frame, Intrinsics

N_FEATURES = 1000
"""Strongest SIFT features kept a frame."""
GRID_WIDTH = 160
"""Width in pixels of the thinned depth that surfaces are compared on."""
NEAR, FAR = 0.15, 8.0
"""Metres; sensor depth outside is not trusted."""


@dataclass(frozen=True)
class View:
    """One frame, reduced. Depth is the sensor's own, not corrected."""

    name: str
    camera: Intrinsics
    """Camera of the thinned grid."""
    focal: float
    """Focal length of the full depth image, pixels: the unit of image residuals."""
    depth: F32
    """(h, w) metres, 0 where invalid: median-free block mean in inverse depth, only where the block is one surface."""
    normal: F32
    """(h, w, 3) unit, camera frame, toward the camera; 0 where unknown."""
    xy: F64
    """(K, 2) features on the plane z = 1 of the camera frame."""
    z: F64
    """(K,) sensor depth at the features, metres."""
    descriptors: F32
    """(K, 128) of unit length."""
    has_color: bool
    frame: Frame | None = None
    """Where it is from, if its picture may be looked at again."""
    noise: F64 | None = None
    """(K,) localisation noise of each feature over that of SIFT; None: 1."""

    def extended(self, xy: F64, z: F64, noise: float) -> View:
        """With further features after its own, that have no descriptor: nothing is matched to them.

        Args:
            xy: (M, 2) on the plane z = 1.
            z: (M,) sensor depth, metres.
            noise: their localisation noise over that of SIFT.
        """
        own = np.ones(len(self.z)) if self.noise is None else self.noise
        return replace(
            self,
            xy=np.concatenate([self.xy, xy]),
            z=np.concatenate([self.z, z]),
            descriptors=np.concatenate([self.descriptors, np.zeros((len(z), 128), np.float32)]),
            noise=np.concatenate([own, np.full(len(z), noise)]),
        )

    @property
    def points(self) -> F64:
        """(K, 3) features in the camera frame by sensor depth, metres."""
        return np.column_stack([self.xy, np.ones(len(self.xy))]) * self.z[:, None]


@dataclass(frozen=True)
class Match:
    """Features of views i < j that are the same points, verified by a rigid motion in 3D that explains them."""

    i: int
    j: int
    a: NDArray[np.int64]
    """(M,) features of view i."""
    b: NDArray[np.int64]
    """(M,) features of view j."""
    T_i_j: F64
    """(4, 4) motion by depth alone: points of camera j into camera i."""


def prepare(frames: Sequence[Frame]) -> list[View]:
    """Read every frame once and reduce it.

    Raises: what the frames' readers raise.
    """
    views = in_order(lambda i: _view(frames[i]), len(frames))
    return list(track(views, "features", total=len(frames)))


def _view(frame: Frame) -> View:
    inverse = _inverse(frame)
    camera, small, normal = _surface(inverse, frame.intrinsics)
    color = frame.color()
    xy, z, descriptors = np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32)
    if color is not None:
        uv, descriptors = _features(color)
        xy, z = _located(frame, inverse, uv)
        keep = z > 0
        xy, z, descriptors = xy[keep], z[keep], descriptors[keep]
    f = 0.5 * (frame.intrinsics.fx + frame.intrinsics.fy)
    return View(frame.name, camera, f, small, normal, xy, z, descriptors, color is not None, frame)


def _inverse(frame: Frame) -> F32:
    """(H, W) inverse depth, 0 where there is none to be trusted."""
    depth = np.where((d := frame.depth()) > NEAR, d, 0).astype(np.float32)
    depth[~(depth < FAR)] = 0
    return np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)


def points_of(frame: Frame, uv: F64) -> tuple[F64, F64]:
    """Positions (K, 2) on the plane z = 1 and sensor depths (K,) of pixels (K, 2) of the colour image; depth 0 where
    there is no smooth surface."""
    return _located(frame, _inverse(frame), uv)


def _located(frame: Frame, inverse: F32, uv: F64) -> tuple[F64, F64]:
    c = frame.color_intrinsics or frame.intrinsics
    return _in_depth_camera((uv - (c.cx, c.cy)) / (c.fx, c.fy), inverse, frame)


def _in_depth_camera(rays: F64, inverse: F32, frame: Frame) -> tuple[F64, F64]:
    """Positions (K, 2) on the plane z = 1 of the depth camera, and depths (K,), of rays (K, 2) of the colour camera."""
    z = _depth_at(inverse, rays, frame.intrinsics)
    if frame.color_shift == (0.0, 0.0):
        return rays, z
    xy = rays
    for _ in range(3):  # where a ray lands depends on the depth that it meets there
        typical = np.median(z[z > 0]) if (z > 0).any() else 1.0
        xy = rays + np.asarray(frame.color_shift) / np.where(z > 0, z, typical)[:, None]
        z = _depth_at(inverse, xy, frame.intrinsics)
    return xy, z


def _features(color: NDArray[np.uint8]) -> tuple[F64, F32]:
    """SIFT: (K, 2) pixels and (K, 128) unit descriptors. RootSIFT (Arandjelovic and Zisserman 2012)."""
    import cv2

    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    # Without `enable_precise_upscale` features of the first octave sit a quarter pixel off: 0.04 percent of the depth
    # gain on rendered captures.
    sift = cv2.SIFT_create(N_FEATURES, 3, 0.02, 10, 1.6, True)  # type: ignore[attr-defined]
    points, raw = sift.detectAndCompute(gray, None)
    if raw is None or not len(points):
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    uv = np.array([p.pt for p in points])
    # One point often carries two orientations; as two features they would count the same evidence twice.
    _, first = np.unique(np.round(uv, 2), axis=0, return_index=True)
    first.sort()
    root = np.sqrt(raw[first] / np.maximum(raw[first].sum(1, keepdims=True), 1e-6))
    return uv[first], root.astype(np.float32)


def _depth_at(inverse: F32, xy: F64, camera: Intrinsics) -> F64:
    """(K,) depth at (K, 2) sub-pixel positions, 0 where there is no single smooth surface in the 5x5 window.

    Inverse depth is linear in the image on any plane, so a linear fit in it neither biases nor blurs slanted faces.
    """
    h, w = inverse.shape
    u, v = xy[:, 0] * camera.fx + camera.cx, xy[:, 1] * camera.fy + camera.cy
    c, r = np.round(u).astype(int), np.round(v).astype(int)
    z = np.zeros(len(xy))
    ok = np.flatnonzero((c >= 2) & (r >= 2) & (c < w - 2) & (r < h - 2))
    dr, dc = (o.ravel() for o in np.mgrid[-2:3, -2:3])
    D = inverse[r[ok, None] + dr, c[ok, None] + dc].astype(float)
    valid = D > 0
    full = (valid.sum(1) >= 18) & valid[:, 12]
    ok, D, valid = ok[full], D[full], valid[full]
    basis = np.broadcast_to(np.column_stack([np.ones(25), dc, dr]), (len(ok), 25, 3)) * valid[..., None]
    fit = np.linalg.solve(
        np.swapaxes(basis, 1, 2) @ basis + 1e-9 * np.eye(3), np.swapaxes(basis, 1, 2) @ (D * valid)[..., None]
    )[..., 0]
    off = np.abs(D - np.einsum("kms,ks->km", basis, fit)) * valid
    value = fit[:, 0] + fit[:, 1] * (u[ok] - c[ok]) + fit[:, 2] * (v[ok] - r[ok])
    # Relative step within the window: beyond 2 percent it is an edge or a flying pixel, not a slope plus noise.
    smooth = (off.max(1) < 0.02 * value) & (np.hypot(fit[:, 1], fit[:, 2]) < 0.02 * value)
    z[ok[smooth]] = 1 / value[smooth]
    return z


def _surface(inverse: F32, camera: Intrinsics) -> tuple[Intrinsics, F32, F32]:
    """Thinned camera, depth (h, w) and normals (h, w, 3)."""
    k = max(1, camera.width // GRID_WIDTH)
    h, w = camera.height // k, camera.width // k
    thin = Intrinsics(w, h, camera.fx / k, camera.fy / k, (camera.cx + 0.5) / k - 0.5, (camera.cy + 0.5) / k - 0.5)
    blocks = inverse[: h * k, : w * k].reshape(h, k, w, k).swapaxes(1, 2).reshape(h, w, k * k)
    valid = blocks > 0
    count = valid.sum(-1)
    mean = blocks.sum(-1) / np.maximum(count, 1)
    spread = np.where(valid, np.abs(blocks - mean[..., None]), 0).max(-1)
    ok = (count >= 0.7 * k * k) & (spread < 0.05 * mean)
    q = np.where(ok, mean, np.nan)
    # Inverse depth is q = (n·ray) / offset: its image gradient gives the normal directly (central differences over
    # five cells, wide enough to quieten millimetre noise).
    gu, gv = np.full_like(q, np.nan), np.full_like(q, np.nan)
    gu[:, 2:-2] = (2 * (q[:, 4:] - q[:, :-4]) + q[:, 3:-1] - q[:, 1:-3]) / 10
    gv[2:-2] = (2 * (q[4:] - q[:-4]) + q[3:-1] - q[1:-3]) / 10
    nx, ny = gu * thin.fx, gv * thin.fy
    rays = thin.rays()
    n = -np.stack([nx, ny, q - nx * rays[..., 0] - ny * rays[..., 1]], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    # A crease shows as a change between one-sided gradients; there the normal is of neither face.
    bend_u, bend_v = np.full_like(q, np.nan), np.full_like(q, np.nan)
    bend_u[:, 2:-2] = np.abs(q[:, 4:] - 2 * q[:, 2:-2] + q[:, :-4])
    bend_v[2:-2] = np.abs(q[4:] - 2 * q[2:-2] + q[:-4])
    flat = (bend_u < 0.02 * q) & (bend_v < 0.02 * q)
    n = np.where((flat & np.isfinite(n).all(-1))[..., None], n, 0)
    return thin, np.where(ok, 1 / np.maximum(mean, 1e-6), 0).astype(np.float32), n.astype(np.float32)


# ---------------------------------------------------------------- matches


def match(views: Sequence[View], i: int, j: int, seed: int = 0) -> Match | None:
    """Verified matches of two views, or None if fewer than 12 points share one rigid motion."""
    A, B = views[i], views[j]
    a, b = match_descriptors(A, B)
    if len(a) < 12:
        return None
    rng = np.random.default_rng((seed, i, j))
    found = rigid_ransac(A.points[a], B.points[b], rng)
    if found is None:
        return None
    T, inlier = found
    return Match(i, j, a[inlier], b[inlier], T)


def match_descriptors(A: View, B: View) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Features (M,) of two views that are each other's most alike by far. Their depth has no say."""
    if min(len(A.z), len(B.z)) < 12:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    likeness = A.descriptors @ B.descriptors.T
    rows = np.arange(len(likeness))
    b = likeness.argmax(1)
    best = likeness[rows, b]
    mutual = likeness.argmax(0)[b] == rows
    likeness[rows, b] = -1
    second = likeness.max(1)
    # Lowe's ratio test on distances of unit vectors, |x - y|^2 = 2 - 2 x·y.
    keep = np.flatnonzero(mutual & ((1 - best) < 0.85**2 * (1 - second)))
    return keep, b[keep]


def rigid_ransac(P: F64, Q: F64, rng: np.random.Generator, trials: int = 1000) -> tuple[F64, Bool] | None:
    """T with P = T Q from noisy matches (M, 3) by three-point samples; None below 12 inliers.

    An inlier is off by less than 1 percent of its depth plus 1 cm: three times the depth noise that consumer sensors
    have at 2 m, and twice a pixel of image noise.
    """
    limit = 0.01 * np.minimum(P[:, 2], Q[:, 2]) + 0.01
    pick = rng.integers(len(P), size=(trials, 3))  # a triple with one point twice is a wasted trial, no more
    R, t = _motions_of_triples(P[pick], Q[pick])
    # |R q + t - p|^2 multiplied out: one product of what belongs to the trials with what belongs to the matches.
    of_trial = np.column_stack(
        [-2 * R.reshape(-1, 9), 2 * (t[:, None] @ R)[:, 0], -2 * t, (t**2).sum(1), np.ones(trials)]
    )
    outer, squares = (P[:, :, None] * Q[:, None]).reshape(-1, 9), (P**2).sum(1) + (Q**2).sum(1)
    near = of_trial @ np.column_stack([outer, Q, P, np.ones(len(P)), squares]).T < limit**2
    inlier = near[near.sum(1).argmax()]
    for _ in range(3):
        if inlier.sum() < 12:
            return None
        p, q = P[inlier].mean(0), Q[inlier].mean(0)
        R1 = nearest_rotation((P[inlier] - p).T @ (Q[inlier] - q))  # Kabsch 1976
        T = make_T(R1, p - R1 @ q)
        inlier = np.linalg.norm(transform(T, Q) - P, axis=1) < limit
    return (T, inlier) if inlier.sum() >= 12 else None


def _motions_of_triples(P: F64, Q: F64) -> tuple[F64, F64]:
    """Least-squares rotations (T, 3, 3) and translations (T, 3) with P = R Q + t of three points each (T, 3, 3).

    The best rotation lays one triangle's plane on the other's; what is left is an angle in it, in closed form: twenty
    times faster than a singular value decomposition a triple. Three points in a line get no rotation that fits.
    """
    p, q = P.mean(1, keepdims=True), Q.mean(1, keepdims=True)
    F, G = _frames_of_triples(P), _frames_of_triples(Q)
    a, b = ((A @ B[..., :2]).view(complex)[..., 0] for A, B in ((P - p, F), (Q - q, G)))
    # Noise turns thin triangles over: their mirror images fit better then, that is, the plane seen from behind.
    over = np.abs((a * b).sum(1)) > np.abs((a * b.conj()).sum(1))
    G, b = G * np.where(over[:, None, None], (1, -1, -1), 1), np.where(over[:, None], b.conj(), b)
    turn = (a * b.conj()).sum(1)
    axes = (F[..., 0] + 1j * F[..., 1]) * (turn.conj() / np.maximum(np.abs(turn), 1e-12))[:, None]
    R = np.stack([axes.real, axes.imag, F[..., 2]], -1) @ np.swapaxes(G, 1, 2)
    return R, p[:, 0] - (R @ q[:, 0, :, None])[..., 0]


def _frames_of_triples(P: F64) -> F64:
    """(T, 3, 3) axes as columns, the first along a side of each triangle (T, 3, 3), the last across it."""
    side = P[:, 1] - P[:, 0]
    across = np.cross(side, P[:, 2] - P[:, 0])
    axes = np.stack([side, np.cross(across, side), across], -1)
    return axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)


# ---------------------------------------------------------------- tracks


@dataclass(frozen=True)
class Tracks:
    """Observations of points that several views share, sorted by point."""

    view: NDArray[np.int64]
    """(M,)."""
    point: NDArray[np.int64]
    """(M,) in 0..count-1, ascending."""
    xy: F64
    """(M, 2) on the plane z = 1."""
    z: F64
    """(M,) sensor depth, metres."""
    focal: F64
    """(M,) pixels, over the feature's noise."""
    count: int
    feature: NDArray[np.int64]
    """(M,) which feature of its view."""

    def where(self, keep: Bool) -> Tracks:
        """Those observations (M,) only, of the points that they leave."""
        left, point = np.unique(self.point[keep], return_inverse=True)
        view, feature = self.view[keep], self.feature[keep]
        return Tracks(view, point, self.xy[keep], self.z[keep], self.focal[keep], len(left), feature)

    def of_features(self, views: Sequence[View]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The point of every feature of the views that were tracked, -1 where it has none, all views in one row,
        and where each view begins in it (N,)."""
        start = np.cumsum([0] + [len(v.z) for v in views])
        point = np.full(int(start[-1]), -1)
        point[start[self.view] + self.feature] = self.point
        return point, start[:-1]


def build_tracks(views: Sequence[View], matches: Sequence[Match]) -> Tracks:
    """Join matches into tracks. A track that meets one view twice is contradictory and left out."""
    start = np.cumsum([0] + [len(v.z) for v in views])
    total = int(start[-1])
    empty: Any = np.zeros(0, int)
    a = np.concatenate([start[m.i] + m.a for m in matches]) if matches else empty
    b = np.concatenate([start[m.j] + m.b for m in matches]) if matches else empty
    label = linked(a, b, total)
    feature = np.unique(np.concatenate([a, b]))
    owner = np.searchsorted(start, feature, side="right") - 1
    key = np.stack([label[feature], owner], 1)
    _, group, times = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    bad = np.unique(key[times[group.ravel()] > 1, 0])
    keep = ~np.isin(key[:, 0], bad)
    feature, owner, label = feature[keep], owner[keep], key[keep, 0]
    _, point = np.unique(label, return_inverse=True)
    order = np.argsort(point, kind="stable")
    feature, owner, point = feature[order], owner[order], point[order]
    xy = np.concatenate([v.xy for v in views])[feature] if total else np.zeros((0, 2))
    z = np.concatenate([v.z for v in views])[feature] if total else np.zeros(0)
    focal = np.array([v.focal for v in views])[owner]
    if any(v.noise is not None for v in views):
        every = np.concatenate([np.ones(len(v.z)) if v.noise is None else v.noise for v in views])
        focal = focal / every[feature]
    count = int(point[-1]) + 1 if len(point) else 0
    return Tracks(owner, point, xy, z, focal, count, feature - start[owner])


class Evidence:
    """The views of a capture and the matches between them, each pair matched once and remembered."""

    def __init__(self, views: Sequence[View], seed: int = 0) -> None:
        self.views = list(views)
        self.seed = seed
        self._matches: dict[tuple[int, int], Match | None] = {}

    @classmethod
    def of(cls, frames: Sequence[Frame], seed: int = 0) -> Evidence:
        """Read and reduce all frames."""
        return cls(prepare(frames), seed)

    def matches(self, pairs: Sequence[tuple[int, int]]) -> list[Match]:
        """Verified matches of those pairs i < j that have any."""
        new = [p for p in dict.fromkeys(pairs) if p not in self._matches]
        found = in_order(lambda k: match(self.views, *new[k], self.seed), len(new))
        self._matches |= zip(new, track(found, "matches", len(new)), strict=True)
        return [m for p in pairs if (m := self._matches[p]) is not None]

    @property
    def has_features(self) -> bool:
        return any(len(v.z) for v in self.views)

    def without_color(self) -> Evidence:
        """The same views without their features: surfaces alone."""
        xy, z, none = np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32)
        return Evidence([replace(v, xy=xy, z=z, descriptors=none, noise=None) for v in self.views], self.seed)

    def subset(self, keep: Sequence[int]) -> Evidence:
        """The same for some of the views, renumbered; their matches are kept."""
        new = {old: k for k, old in enumerate(keep)}
        out = Evidence([self.views[k] for k in keep], self.seed)
        for (i, j), m in self._matches.items():
            if i in new and j in new and new[i] < new[j]:
                out._matches[new[i], new[j]] = None if m is None else replace(m, i=new[i], j=new[j])
        return out
