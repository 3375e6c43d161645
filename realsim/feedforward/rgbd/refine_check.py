"""Do given poses agree with what the frames show?

An edge is a pair of frames and by how many metres the poses misplace one frame's points in the other. Where two
frames share verified features, these are the same points; elsewhere it is depth against depth where the poses say that
both look. A few frames with wrong poses are named so that they can be dropped. Poses that are wrong as a whole are
refused, and the usual conventions are tried to say which one it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from realsim.core.errors import PoseError
from realsim.core.geometry import invert_T, make_T, transform
from realsim.core.types import F64, Dropped, Frame
from realsim.feedforward.rgbd.loops import LINKS, plausible
from realsim.feedforward.rgbd.refine_pairs import choose_pairs, look_up, overlap, sample_surface
from realsim.feedforward.rgbd.together import has_own_depth
from realsim.feedforward.rgbd.tracks import Evidence, View

TOLERANCE = (0.05, 0.12)
"""Metres: an edge contradicts beyond four times the median edge, but within these. Handheld trackers are off by 1 to
2 cm and half a degree, which is 3 cm at 2 m."""
CLEARER = 0.35
"""Share of the misplacement that another reading may leave to be named as what went wrong. Held by tests on rendered
captures; of two of them and the real chair with their own poses nothing is reported."""
SCALE_LIMIT = 0.05
"""Relative difference of scale between poses and depth that no depth camera explains, at the least: three standard
errors of the sensor's own scale are allowed."""
MOST = 0.75
"""Share of the points of two depth images that must agree: half of them lie on a floor, and floors fit each other. Set
on two captures with frames of two places under the poses of one: all of 70 pairs across contradict, while half of the
points agree in 20 of them. Within six captures with their own poses 0 to 2 % of the pairs contradict, in one with poses
2 cm off 19 % do by the least limit."""
MANY = 0.3
"""Share of contradicting frames from which the poses as a whole are in question."""


@dataclass(frozen=True)
class Edge:
    """Points (M, 3) of two frames, each in its own camera and sensor depth."""

    i: int
    j: int
    p: F64
    """(M, 3) camera i."""
    q: F64
    """(M, 3) the same points in camera j by features; else (K, 3) points that j sees. Where `t` is None, points of
    either are looked up in the other's depth."""
    t: F64 | None
    """(3,) where camera j stands in camera i, by features and depth alone; None: no features."""


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of the poses with the frames."""

    agreement: F64
    """(N,) share of a frame's edges that agree, NaN where no other frame shows the same."""
    contradicting: tuple[Dropped, ...]
    """Frames whose pose most others contradict."""
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def kept(self, frames: Sequence[Frame]) -> list[int]:
        """Indices of the frames that are not contradicted."""
        bad = {d.name for d in self.contradicting}
        return [k for k, f in enumerate(frames) if f.name not in bad]


def check_poses(
    frames: Sequence[Frame],
    T_world_camera: F64,
    *,
    evidence: Evidence | None = None,
    seed: int = 0,
    sensor_sigma: float = 0.006,
    source: Path | None = None,
) -> PoseCheck:
    """Compare poses (N, 4, 4), camera to world, OpenCV axes, metres, with the frames; `source` is named in errors.

    Raises:
        PoseError: the poses as a whole contradict the depth; the message names the convention that would agree.
    """
    T = np.asarray(T_world_camera, float)
    evidence = evidence or Evidence.of(frames, seed)
    n = len(frames)
    edges = _edges(evidence, T, seed)
    error = _errors(edges, evidence, T, MOST)
    pair = np.array([(e.i, e.j) for e in edges]).reshape(-1, 2)
    weight = np.array([0.3 if e.t is None else 1.0 for e in edges])
    seen = np.isfinite(error)
    if not seen.any() and (found := _explain(edges, evidence, T, 2 * TOLERANCE[1], None)):
        raise PoseError(
            f"with the given poses no two frames show the same surface: they look like {found[0]}",
            file=source,
            hint=found[2],
        )
    if not seen.any():
        text = "the poses could not be checked: no two frames show the same surface"
        return PoseCheck(np.full(n, np.nan), (), (text,), {"edges": 0})
    certain = seen & (weight == weight[seen].max())
    typical = float(np.median(_errors(edges, evidence, T)[certain]))
    limit = float(np.clip(4 * typical, *TOLERANCE))
    bad = _greedy(pair[seen], weight[seen], error[seen] > limit, n)
    agreement, middle = _per_frame(pair[seen], weight[seen], error[seen], limit, n)
    bad |= _nowhere(evidence, T, agreement)
    agreeing = pair[seen & (error <= limit)]
    pieces = _pieces(agreeing, np.zeros(n, bool), n)
    # By depth alone: likeness may be false wherever pieces meet. So many pairs see the same surface, and none agrees.
    strangers = [p for p in pieces[1:] if _between(pair[seen & (weight < 1)], p, pieces[0]) >= LINKS]
    bad[[k for p in strangers for k in p]] = True
    pieces = _pieces(agreeing, bad, n)
    scale, spread = _scale(edges, T)
    found = _explain(edges, evidence, T, typical, scale)
    statistics: dict[str, Any] = {
        "edges": int(seen.sum()),
        "feature_edges": int((weight == 1).sum()),
        "typical_m": typical,
        "limit_m": limit,
        "contradicting_edges": float((error[seen] > limit).mean()),
        "pose_scale": None if scale is None else 1 / scale,
    }
    allowed = max(SCALE_LIMIT, 3 * sensor_sigma, 3 * spread)
    explained = found is not None and typical > TOLERANCE[0] and found[1] < CLEARER * typical
    reasons = []
    if bad.sum() > MANY * n:
        named = f"{frames[np.flatnonzero(bad)[0]].name} to {frames[np.flatnonzero(bad)[-1]].name}"
        reasons.append(f"{bad.sum()} of {n} frames contradict most of the others ({named})")
    if scale is not None and abs(scale - 1) > allowed:
        off = scale - 1
        reasons.append(f"baselines by depth are {off:+.1%} of those by the poses; this sensor allows {allowed:.0%}")
    if explained or typical >= TOLERANCE[1]:
        reasons.append(f"points misplaced by {100 * typical:.1f} cm (median)")
    if statistics["contradicting_edges"] > 0.5:
        reasons.append(f"{statistics['contradicting_edges']:.0%} of the pairs of frames contradict the poses")
    fit = _by_depth_alone(edges, evidence, T) if reasons else float("inf")
    if found and fit < TOLERANCE[0] < found[1]:
        found = None  # the depth agrees with the poses as they are, so it is not their convention that is wrong
    if (reasons or typical > TOLERANCE[0]) and not found and (late := _late_depth(edges, evidence, T)) is not None:
        moved = f"{100 * late[1]:.1f} cm with the depth images moved back, {100 * typical:.1f} cm as they are"
        raise PoseError(
            f"the depth images are {abs(late[0])} frames {'late' if late[0] > 0 else 'early'}",
            file=source,
            expected="colour, depth and pose of one instant in each frame",
            found="; ".join([*reasons, moved]),
            hint="associate colour and depth by their time stamps anew",
        )
    if not found and fit < TOLERANCE[0] and not has_own_depth(evidence.views, seed):
        raise PoseError(
            "the colour images belong to other depth images than those they are named with",
            file=source,
            expected="colour and depth of the same view",
            found=f"{'; '.join(reasons)}; without colour, poses and depth agree to {100 * fit:.1f} cm",
            hint="check that colour and depth come from one capture and carry the same numbers or times",
        )
    if reasons:
        several = not found and bad.sum() > MANY * n and bool(pieces) and len(pieces[0]) > MANY * n
        seems = found[0] if found else "poses of more than one place" if several else ""
        raise PoseError(
            "the given poses contradict the depth" + (f": they look like {seems}" if seems else ""),
            file=source,
            expected="camera to world, OpenCV camera axes (x right, y down, z forward), metres",
            found="; ".join(reasons) + (f"; {100 * found[1]:.1f} cm with {found[0]} undone" if found else ""),
            hint=found[2] if found else _leave(frames, pieces[0]) if several else _way_out(fit),
        )
    warnings = []
    if not found and typical > TOLERANCE[0] and (fit := _by_depth_alone(edges, evidence, T)) < CLEARER * typical:
        warnings.append(
            f"features of the colour images contradict the poses ({100 * typical:.1f} cm), depth does not "
            f"({100 * fit:.1f} cm): is the colour of another capture or time, or not registered to depth?"
        )
    if found and typical > 0.02:
        warnings.append(f"poses agree only roughly ({100 * typical:.1f} cm); {found[0]} would explain it")
    if (alone := n - int(bad.sum()) - sum(map(len, pieces))) > 0:
        warnings.append(f"{alone} frames share no surface with others that are used: their poses could not be checked")
    if len(pieces) > 1:
        names = " and ".join(_span(frames, p) for p in pieces[:4])
        warnings.append(
            f"nothing that the frames show joins {names}: their poses to each other could not be checked; "
            "are they of one place?"
        )
    dropped = _named(frames, bad, agreement, middle, strangers, pieces)
    return PoseCheck(agreement, dropped, tuple(warnings), statistics)


def scale_by_depth(evidence: Evidence, T_world_camera: F64) -> tuple[float, float]:
    """What positions that are right up to scale must be multiplied by to be in the depth's metres, and the relative
    standard error of it: baselines of neighbouring frames by features with depth, against those of the poses.

    Raises:
        PoseError: fewer than 8 pairs of frames match that are 10 cm apart.
    """
    n = len(T_world_camera)
    matched = evidence.matches([(i, i + step) for step in (1, 2, 3) for i in range(n - step)])
    none = np.zeros((0, 3))
    scale, error = _scale([Edge(m.i, m.j, none, none, m.T_i_j[:3, 3]) for m in matched], T_world_camera)
    if scale is None:
        raise PoseError(
            "the scale of the given poses cannot be determined",
            expected="at least 8 pairs of neighbouring frames, 10 cm apart, that share features",
            found=f"{len(matched)} pairs that match",
            hint="have the poses estimated (--poses estimate)",
        )
    return scale, error / scale


def _edges(evidence: Evidence, T: F64, seed: int) -> list[Edge]:
    pairs = choose_pairs(evidence.views, T)
    matched = {(m.i, m.j): m for m in plausible(evidence, pairs, T)}
    rng = np.random.default_rng(seed)
    samples = [sample_surface(view, rng, 100)[0] for view in evidence.views]
    out = []
    for i, j in pairs:
        m = matched.get((i, j))
        if m is not None:
            some = np.unique(np.linspace(0, len(m.a) - 1, 60).astype(int))
            p, q = evidence.views[i].points[m.a[some]], evidence.views[j].points[m.b[some]]
            out.append(Edge(i, j, p, q, m.T_i_j[:3, 3]))
        else:
            out.append(Edge(i, j, samples[i], samples[j], None))
    return out


def _errors(edges: Sequence[Edge], evidence: Evidence, T: F64, share: float = 0.5) -> F64:
    """Median misplacement of each edge's points under poses T, metres; by depth the one that a `share` of them is
    within. NaN where too little is seen to tell."""
    out = np.full(len(edges), np.nan)
    for k, e in enumerate(edges):
        D = invert_T(T[e.j]) @ T[e.i]
        if e.t is not None:
            out[k] = np.median(np.linalg.norm(transform(D, e.p) - e.q, axis=1))
            continue
        views = evidence.views
        off = np.concatenate([_off(views[e.j], transform(D, e.p)), _off(views[e.i], transform(invert_T(D), e.q))])
        if len(off) >= 20:
            out[k] = np.quantile(np.abs(off), share)
    return out


def _off(view: View, y: F64) -> F64:
    """By how much points y (M, 3) of a view's camera lie behind what it sees there (K,), metres; not those that it
    cannot see because something hides them, which no pose forbids."""
    q, _, ok = look_up(view, y)
    behind = y[ok, 2] - q[ok, 2]
    return behind[behind < TOLERANCE[1]]


def _by_depth_alone(edges: Sequence[Edge], evidence: Evidence, T: F64) -> float:
    """Median misplacement by depth of the pairs that features speak of; infinite where it cannot be told."""
    rng = np.random.default_rng(0)
    matched = [e for e in edges if e.t is not None]
    seen = [[sample_surface(evidence.views[k], rng, 100)[0] for k in (e.i, e.j)] for e in matched]
    bare = [Edge(e.i, e.j, p, q, None) for e, (p, q) in zip(matched, seen, strict=True)]
    error = _errors(bare, evidence, T)
    return float(np.nanmedian(error)) if np.isfinite(error).sum() >= 4 else float("inf")


def _way_out(fit: float) -> str:
    """What to do where no convention explains it; `fit` as `_by_depth_alone` has it."""
    if fit > TOLERANCE[0]:
        return "estimate the poses from the frames instead (--poses estimate)"
    return (
        f"surfaces agree with the poses to {100 * fit:.1f} cm, features do not: leave out frames in which "
        "something large moved, or that are of another place, or estimate the poses (--poses estimate)"
    )


def _leave(frames: Sequence[Frame], piece: Sequence[int]) -> str:
    return (
        f"of these {_span(frames, piece)} agree with each other: leave out the others if they are of another place, or "
        "estimate the poses (--poses estimate)"
    )


def _span(frames: Sequence[Frame], piece: Sequence[int]) -> str:
    return f"{frames[piece[0]].name} to {frames[piece[-1]].name} ({len(piece)} frames)"


def _late_depth(edges: Sequence[Edge], evidence: Evidence, T: F64) -> tuple[int, float] | None:
    """(frames by which depth is late, misplacement once undone) where depth alone says so clearly."""
    fits = {shift: _by_depth_alone(edges, evidence, _shifted(T, -shift)) for shift in range(-4, 5)}
    shift = min(fits, key=lambda s: fits[s])
    return (shift, fits[shift]) if shift and fits[shift] < min(TOLERANCE[0], CLEARER * fits[0]) else None


def _greedy(pair: np.ndarray, weight: F64, wrong: np.ndarray, n: int) -> np.ndarray:
    """Take out the frame with the largest contradicted share until every frame agrees with most of the others.

    One at a time, because one wrong pose makes all its neighbours look bad.
    """
    bad = np.zeros(n, bool)
    while True:
        live = ~bad[pair].any(1)
        total = np.bincount(pair[live].ravel(), np.repeat(weight[live], 2), n)
        against = np.bincount(pair[live].ravel(), np.repeat(weight[live] * wrong[live], 2), n)
        share = np.divide(against, total, out=np.zeros(n), where=total > 0)
        if share.max(initial=0) <= 0.5:
            return bad
        # Of equal shares, the one with more evidence against it.
        bad[np.lexsort((against, share))[-1]] = True


def _per_frame(pair: np.ndarray, weight: F64, error: F64, limit: float, n: int) -> tuple[F64, F64]:
    agreement, middle = np.full(n, np.nan), np.full(n, np.nan)
    for k in range(n):
        mine = (pair == k).any(1)
        if mine.any():
            agreement[k] = np.average(error[mine] <= limit, weights=weight[mine])
            middle[k] = np.median(error[mine])
    return agreement, middle


def _pieces(agreeing: np.ndarray, bad: np.ndarray, n: int) -> list[list[int]]:
    """Frames that pairs (M, 2) which agree join with one another, two or more, the largest first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = agreeing[~bad[agreeing].any(axis=1)]
    _, piece = connected_components(coo_matrix((np.ones(len(links)), links.T), shape=(n, n)), directed=False)
    found = [np.flatnonzero((piece == k) & ~bad).tolist() for k in np.unique(piece[~bad])]
    return sorted((p for p in found if len(p) > 1), key=len, reverse=True)


def _between(pair: np.ndarray, a: Sequence[int], b: Sequence[int]) -> int:
    """Number of pairs (M, 2) of a frame of one piece and one of the other."""
    of = [np.isin(pair, piece) for piece in (a, b)]
    return int(((of[0][:, 0] & of[1][:, 1]) | (of[1][:, 0] & of[0][:, 1])).sum())


def _nowhere(evidence: Evidence, T: F64, agreement: F64) -> np.ndarray:
    """Frames that overlap with nothing although the frames before and after see the same surface."""
    bad = np.zeros(len(T), bool)
    for k in np.flatnonzero(np.isnan(agreement)).tolist():
        if 0 < k < len(T) - 1:
            z = evidence.views[k - 1].depth
            points = (evidence.views[k - 1].camera.rays() * z[..., None])[z > 0][::97].astype(float)
            bad[k] = len(points) > 0 and overlap(evidence.views, T, k - 1, np.array([k + 1]), points)[0] > 0.3
    return bad


def _scale(edges: Sequence[Edge], T: F64) -> tuple[float | None, float]:
    """Metres by depth for a metre by poses (median over edges with a baseline), and its standard error."""
    known = [e for e in edges if e.t is not None]
    given = np.array([(invert_T(T[e.i]) @ T[e.j])[:3, 3] for e in known]).reshape(-1, 3)
    found = np.array([e.t for e in known]).reshape(-1, 3)
    long = np.linalg.norm(found, axis=1) > 0.1
    if long.sum() < 8:
        return None, 0.0
    # Lengths, not components: they do not depend on a wrong convention of the axes.
    ratio = np.linalg.norm(found[long], axis=1) / np.maximum(np.linalg.norm(given[long], axis=1), 1e-9)
    middle = np.median(ratio)
    return float(middle), float(1.4826 * np.median(np.abs(ratio - middle)) / np.sqrt(long.sum()) * 1.25)


# ---------------------------------------------------------------- what it may be

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
BODY = make_T(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""OpenCV camera axes written in x forward, y left, z up."""


def _turned(degrees: float) -> F64:
    return make_T(Rotation.from_euler("z", degrees, degrees=True).as_matrix())


CONVENTIONS: tuple[tuple[str, str, Callable[[F64], F64]], ...] = (
    ("OpenGL camera axes (y up, z backward)", "turn y and z of the camera axes", lambda T: T @ FLIP),
    ("world-to-camera matrices", "invert the matrices", invert_T),
    ("OpenGL world-to-camera matrices", "invert the matrices and turn y and z", lambda T: invert_T(T) @ FLIP),
    ("body axes (x forward, y left, z up)", "rotate to camera axes", lambda T: T @ BODY),
    ("a camera turned by 90 degrees", "images or poses were rotated for portrait", lambda T: T @ _turned(90)),
    ("a camera turned by -90 degrees", "images or poses were rotated for portrait", lambda T: T @ _turned(-90)),
    ("a camera turned by 180 degrees", "images or poses were rotated", lambda T: T @ _turned(180)),
    ("mirrored images, or poses of left-handed axes", "mirror images or poses", lambda T: MIRROR @ T @ MIRROR),
)


def _hypotheses(T: F64, scale: float | None) -> Iterator[tuple[str, str, F64]]:
    for name, hint, undo in CONVENTIONS:
        yield name, hint, undo(T)
    factors = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
    if scale is not None:
        factors[f"poses of another scale ({1 / scale:.3g} units a metre)"] = scale
    for name, factor in factors.items():
        scaled = T.copy()
        scaled[:, :3, 3] *= factor
        yield (
            name,
            f"multiply the positions by {factor:.4g}, or pass --no-metric-poses: the depth then scales them",
            scaled,
        )
    for shift in (-4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4):
        text = f"a time offset between poses and images of {-shift:g} frames"
        yield text, "associate poses and images by their timestamps anew", _shifted(T, shift)


def _shifted(T: F64, shift: float) -> F64:
    """Poses `shift` frames later, interpolated, held at the ends."""
    n = len(T)
    at = np.clip(np.arange(n) + shift, 0, n - 1)
    out = np.tile(np.eye(4), (n, 1, 1))
    if n < 2:
        return T
    out[:, :3, :3] = Slerp(np.arange(n), Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix()
    low = np.minimum(at.astype(int), n - 2)
    part = (at - low)[:, None]
    out[:, :3, 3] = (1 - part) * T[low, :3, 3] + part * T[low + 1, :3, 3]
    return out


def _explain(
    edges: Sequence[Edge], evidence: Evidence, T: F64, typical: float, scale: float | None
) -> tuple[str, float, str] | None:
    """(name, median misplacement once undone, hint) of the convention that agrees best, if it clearly beats none."""
    certain = [e for e in edges if e.t is not None]
    # By depth alone, only frames next to each other surely see the same; poses do not decide who is compared.
    certain = certain if len(certain) >= 8 else [e for e in edges if e.j - e.i <= 3]
    if not certain or typical < 0.02:
        return None
    best: tuple[str, float, str] | None = None
    for name, hint, other in _hypotheses(T, scale):
        error = _errors(certain, evidence, other)
        # A convention under which frames no longer see each other explains nothing.
        if np.isfinite(error).mean() < 0.7:
            continue
        value = float(np.nanmedian(error))
        if value < min(0.5 * typical, TOLERANCE[1]) and (best is None or value < 0.999 * best[1]):
            best = (name, value, hint)
    return best


def _named(
    frames: Sequence[Frame],
    bad: np.ndarray,
    agreement: F64,
    middle: F64,
    strangers: Sequence[Sequence[int]],
    pieces: Sequence[Sequence[int]],
) -> tuple[Dropped, ...]:
    out = []
    of = {k: piece for piece in strangers for k in piece}
    for k in np.flatnonzero(bad).tolist():
        if k in of:
            reason = (
                f"{_span(frames, of[k])} agree with each other and with no frame of {_span(frames, pieces[0])}, where "
                "by the poses both see the same surface: of another place, or their poses jump"
            )
        elif np.isnan(agreement[k]):
            reason = "its pose looks at nothing that the frames before and after see"
        else:
            against, off = 100 * (1 - agreement[k]), 100 * middle[k]
            reason = (
                f"its pose contradicts the depth: {against:.0f} percent of the frames it overlaps with disagree, "
                f"by {off:.1f} cm (median)"
            )
        out.append(Dropped(frames[k].name, reason))
    return tuple(out)
