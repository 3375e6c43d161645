"""Runs of a few views each become one set of views: windows joined by similarities, or pairs along a spanning tree."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from realsim.core.progress import track
from realsim.core.types import F32, F64, Bool
from realsim.feedforward.onnx.adapters import Prediction
from realsim.feedforward.onnx.sim3 import MAX_POINTS, Similarity, robust_similarity

OVERLAP = 6
"""Views that neighbouring windows share."""
GLUE = 0.5
"""Share of the points of shared views on which two windows have to agree to be joined."""
PAIR_GLUE = 0.3
"""The same for a pair of a pairwise model, whose views see partly different things."""
ALL_PAIRS = 10
"""Up to this many views every pair is run; beyond, neighbours in the sequence and a few long steps."""
STEPS = (1, 2, 3, 6, 12)

Run = Callable[[Sequence[int]], Prediction]


@dataclass(frozen=True)
class Placed:
    """All views in one scale and world, as far as they hang together."""

    depth: F32
    """(N, H, W) along z."""
    conf: F32
    """(N, H, W)."""
    mask: Bool
    """(N, H, W)."""
    T_world_camera: F64
    """(N, 4, 4)."""
    part: np.ndarray
    """(N,) views of different parts could not be joined: their scales and worlds have nothing to do with each other."""
    claims: tuple[float, ...] = ()
    """Metres per unit of each run, in the common unit."""
    figures: dict[str, list[float]] = field(default_factory=dict)


def windows(n: int, most: int, static: int | None) -> list[tuple[int, ...]]:
    """Views of each run: all at once if they fit, else windows of `most` that share OVERLAP views (or half).

    With a frozen number of views the last window is filled by repeating its last view.
    """
    if n <= most:
        return [_filled(tuple(range(n)), static)]
    step = most - min(OVERLAP, most // 2)
    starts = range(0, max(n - most, 0) + step, step)
    return [_filled(tuple(range(s, min(s + most, n))), static) for s in starts]


def _filled(views: tuple[int, ...], static: int | None) -> tuple[int, ...]:
    return views + (views[-1],) * max((static or 0) - len(views), 0)


def place_windows(run: Run, n: int, most: int, static: int | None) -> Placed:
    """Run the windows in order and lay each onto the one before by what both say about the views that they share."""
    into = _Collector(n)
    before: tuple[tuple[int, ...], Prediction, Similarity] | None = None
    part = 0
    for filled in track(windows(n, most, static), "model"):
        views = tuple(dict.fromkeys(filled))
        found = run(filled)
        S = _IDENTITY
        if before is not None:
            joined = _between(before, (views, found))
            if joined is None:
                part += 1
            else:
                S = joined
        for k, i in enumerate(views):
            if not into.has(i):
                into.put(i, found, k, S, part)
        into.note(found, S)
        before = (views, found, S)
    return into.placed()


def _between(
    a: tuple[tuple[int, ...], Prediction, Similarity], b: tuple[tuple[int, ...], Prediction]
) -> Similarity | None:
    """The similarity that lays run b onto the placed run a, or None where they do not agree."""
    source, target, distance, weight = [], [], [], []
    for i in sorted(set(a[0]) & set(b[0])):
        k, m = a[0].index(i), b[0].index(i)
        ok = a[1].mask[k] & b[1].mask[m]
        at = np.flatnonzero(ok)[:: max(1, int(ok.sum()) // 2000)]
        p, q = (x[1].local_points[y].reshape(-1, 3)[at].astype(float) for x, y in ((b, m), (a, k)))
        Tb, Ta = b[1].T_world_camera[m], a[2].T @ a[1].T_world_camera[k]
        source.append(p @ Tb[:3, :3].T + Tb[:3, 3])
        target.append(q @ Ta[:3, :3].T + Ta[:3, 3])
        distance.append(a[2].scale * q[:, 2])
        weight.append((a[1].conf[k] * b[1].conf[m]).ravel()[at].astype(float))
    if not source:
        return None
    found = robust_similarity(*(np.concatenate(x) for x in (source, target, distance, weight)))
    return found if found is not None and found.inliers >= GLUE else None


_IDENTITY = Similarity(np.eye(4), 1.0, 1.0, 0.0)


class _Collector:
    """Views as they are placed, one after the other."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.views: dict[int, tuple[F32, F32, Bool, F64, int]] = {}
        self.claims: list[float] = []
        self.figures: dict[str, list[float]] = {}

    def has(self, i: int) -> bool:
        return i in self.views

    def put(self, i: int, found: Prediction, k: int, S: Similarity, part: int) -> None:
        """View k of a run as view i: points grow by the similarity's scale, the camera moves by it."""
        T = S.T @ found.T_world_camera[k]
        T[:3, :3] /= S.scale
        z = found.local_points[k, ..., 2] * np.float32(S.scale)
        self.views[i] = (z, found.conf[k], found.mask[k], T, part)

    def note(self, found: Prediction, S: Similarity) -> None:
        if found.metric_scale is not None:
            self.claims.append(found.metric_scale / S.scale)
        for name, value in found.figures.items():
            if np.isfinite(value):
                self.figures.setdefault(name, []).append(float(value))

    def placed(self) -> Placed:
        z, conf, mask, T, part = zip(*(self.views[i] for i in range(self.n)), strict=True)
        return Placed(
            np.stack(z), np.stack(conf), np.stack(mask), np.stack(T), np.array(part), tuple(self.claims), self.figures
        )


# ---------------------------------------------------------------- one view per run


def place_single(run: Run, n: int) -> Placed:
    """Every view by itself: no poses, and a scale of its own."""
    into = _Collector(n)
    for i in track(range(n), "model"):
        found = run((i,))
        into.put(i, found, 0, _IDENTITY, i)
        into.note(found, _IDENTITY)
    return into.placed()


# ---------------------------------------------------------------- pairs


@dataclass(frozen=True)
class _Link:
    """Run (i, j): its unit and frame against the views' own."""

    i: int
    j: int
    S: Similarity
    """Own points of j into own frame and unit of i."""
    weight: float


def place_pairs(run: Run, n: int) -> Placed:
    """Run pairs both ways round, and walk from view to view along the surest ones (a maximum spanning tree).

    A view's own points are those of its surest run as first image. Run (i, j) shows both views in camera i: i's points
    there tell the run's unit, j's points against j's own ones tell where j stands and in what unit.
    """
    pairs = [(i, j) for i in range(n) for j in range(n) if i != j and (n <= ALL_PAIRS or abs(i - j) in STEPS)]
    thin: dict[tuple[int, int], Prediction] = {}
    own: dict[int, tuple[float, Prediction]] = {}
    for pair in track(pairs, "pairs"):
        found = run(pair)
        sure = float(found.conf[0].mean())
        if pair[0] not in own or sure > own[pair[0]][0]:
            own[pair[0]] = (sure, found)
        thin[pair] = _thinned(found)  # all runs at full size would not fit into memory
    coarse = {i: _thinned(found) for i, (_, found) in own.items()}
    links = [link for pair, found in thin.items() if (link := _link(pair, found, coarse)) is not None]
    S, part = _walk(n, links)
    into = _Collector(n)
    for i in range(n):
        into.put(i, own[i][1], 0, S[i], int(part[i]))
        into.note(own[i][1], S[i])
    return into.placed()


def _thinned(found: Prediction) -> Prediction:
    """Every few pixels: as many as a similarity needs."""
    pixels = found.mask.shape[1] * found.mask.shape[2]
    step = max(1, round((pixels / MAX_POINTS) ** 0.5))
    part = (slice(None), slice(step // 2, None, step), slice(step // 2, None, step))
    return replace(
        found, local_points=found.local_points[part].copy(), conf=found.conf[part].copy(), mask=found.mask[part].copy()
    )


def _link(pair: tuple[int, int], found: Prediction, own: dict[int, Prediction]) -> _Link | None:
    i, j = pair
    a, b = own[i], own[j]
    both = found.mask[0] & a.mask[0]
    if both.sum() < 10:
        return None
    unit = float(np.median(a.local_points[0, ..., 2][both] / found.local_points[0, ..., 2][both]))
    ok = np.flatnonzero(found.mask[1] & b.mask[0])
    source = b.local_points[0].reshape(-1, 3)[ok].astype(float)
    target = unit * found.local_points[1].reshape(-1, 3)[ok].astype(float)
    weight = (found.conf[1] * b.conf[0]).ravel()[ok].astype(float)
    S = robust_similarity(source, target, unit * source[:, 2], weight)
    if S is None or S.inliers < PAIR_GLUE:
        return None
    return _Link(i, j, S, S.inliers * float(found.conf[1][found.mask[1]].mean()))


def _walk(n: int, links: list[_Link]) -> tuple[list[Similarity], np.ndarray]:
    """Similarities of all views into the frame of the first view of their part, surest links first (Kruskal)."""
    part = np.arange(n)
    place = [_IDENTITY] * n
    for link in sorted(links, key=lambda e: (-e.weight, e.i, e.j)):
        a, b = int(part[link.i]), int(part[link.j])
        if a == b:
            continue
        # Everything that hangs on j moves along with it.
        move = place[link.i].T @ link.S.T @ np.linalg.inv(place[link.j].T)
        grow = place[link.i].scale * link.S.scale / place[link.j].scale
        for k in np.flatnonzero(part == b):
            place[k] = Similarity(move @ place[k].T, grow * place[k].scale, 1.0, 0.0)
        part[part == b] = a
    return place, part
