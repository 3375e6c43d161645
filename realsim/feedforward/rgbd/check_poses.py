"""Do given poses agree with what the frames show?

An edge is a pair of frames and by how many metres the poses misplace one frame's points in the other. Where two
frames share verified features, these are the same points; elsewhere it is depth against depth where the poses say that
both look. A few frames with wrong poses are named so that they can be dropped. Poses that are wrong as a whole are
refused, and the usual conventions are tried to say which one it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import PoseError
from realsim.core.geometry import invert_T, transform
from realsim.core.meshes import linked
from realsim.core.types import F64, Dropped, Frame
from realsim.feedforward.rgbd.depth_colour_sync import has_own_depth
from realsim.feedforward.rgbd.features import Evidence, View
from realsim.feedforward.rgbd.hypotheses import Hypothesis, best_of, of_depth_images, of_poses
from realsim.feedforward.rgbd.loop_closure import LINKS, keep_plausible
from realsim.feedforward.rgbd.refine_pairs import choose_pairs, look_up, sample_surface, share_in_image

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
class ComparedPair:
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
    found = _compare(frames, T, evidence or Evidence.of(frames, seed), seed)
    if isinstance(found, PoseCheck):
        return found
    if isinstance(found, Hypothesis):
        raise PoseError(
            f"with the given poses no two frames show the same surface: they look like {found.name}",
            file=source,
            hint=found.hint,
        )
    reasons = _reasons(found, sensor_sigma)
    for refuse in REFUSALS:
        if (why := refuse(found, reasons)) is not None:
            text, expected, seen, hint = why
            raise PoseError(text, file=source, expected=expected, found="; ".join([*reasons, *seen]), hint=hint)
    dropped = _named(frames, found.bad, found.agreement, found.middle, found.strangers, found.pieces)
    return PoseCheck(found.agreement, dropped, tuple(_warnings(found)), found.statistics)


@dataclass(frozen=True)
class Comparison:
    """Poses against frames."""

    frames: Sequence[Frame]
    evidence: Evidence
    T: F64
    seed: int
    edges: Sequence[ComparedPair]
    typical: float
    """Metres by which the points that features share are misplaced, the median."""
    contradicting: float
    """Share of the edges that contradict."""
    bad: np.ndarray
    """(N,) frames that most others contradict."""
    agreement: F64
    middle: F64
    """(N,) of each frame's edges: the share that agrees, and the median misplacement in metres."""
    pieces: list[list[int]]
    """Frames that pairs join, the largest piece first."""
    strangers: list[list[int]]
    """Pieces that contradict the first where both see the same surface."""
    scale: tuple[float | None, float]
    """Metres by depth for one by the poses, and its standard error."""
    statistics: dict[str, Any]

    @cached_property
    def convention(self) -> tuple[Hypothesis, float] | None:
        """The reading of the poses that agrees best, and the misplacement that it leaves."""
        return _explain(self.edges, self.evidence, self.T, self.typical, self.scale[0])

    @cached_property
    def by_depth(self) -> float:
        """Misplacement by depth alone, metres."""
        return _by_depth_alone(self.edges, self.evidence, self.T)

    @property
    def several_places(self) -> bool:
        """Whether a large part agrees within itself and many others do not."""
        n = MANY * len(self.frames)
        return bool(self.bad.sum() > n and self.pieces and len(self.pieces[0]) > n)


def _compare(frames: Sequence[Frame], T: F64, evidence: Evidence, seed: int) -> Comparison | PoseCheck | Hypothesis:
    """The comparison; where no two frames see the same, the reading that explains it or a check of nothing."""
    n = len(frames)
    edges = _edges(evidence, T, seed)
    error = _errors(edges, evidence, T, MOST)
    pair = np.array([(e.i, e.j) for e in edges]).reshape(-1, 2)
    weight = np.array([0.3 if e.t is None else 1.0 for e in edges])
    seen = np.isfinite(error)
    if not seen.any():
        explained = _explain(edges, evidence, T, 2 * TOLERANCE[1], None)
        text = "the poses could not be checked: no two frames show the same surface"
        return explained[0] if explained else PoseCheck(np.full(n, np.nan), (), (text,), {"edges": 0})
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
    scale, spread = _scale(edges, T)
    contradicting = float((error[seen] > limit).mean())
    statistics = {
        "edges": int(seen.sum()),
        "feature_edges": int((weight == 1).sum()),
        "typical_m": typical,
        "limit_m": limit,
        "contradicting_edges": contradicting,
        "pose_scale": None if scale is None else 1 / scale,
    }
    return Comparison(
        frames, evidence, T, seed, edges, typical, contradicting, bad, agreement, middle, _pieces(agreeing, bad, n),
        strangers, (scale, spread), statistics,
    )  # fmt: skip


def _reasons(c: Comparison, sensor_sigma: float) -> list[str]:
    """Why the poses as a whole are in question; none if they are not."""
    n, (scale, spread), reasons = len(c.frames), c.scale, []
    if c.bad.sum() > MANY * n:
        bad = np.flatnonzero(c.bad)
        named = f"{c.frames[bad[0]].name} to {c.frames[bad[-1]].name}"
        reasons.append(f"{len(bad)} of {n} frames contradict most of the others ({named})")
    allowed = max(SCALE_LIMIT, 3 * sensor_sigma, 3 * spread)
    if scale is not None and abs(scale - 1) > allowed:
        reasons.append(
            f"baselines by depth are {scale - 1:+.1%} of those by the poses; this sensor allows {allowed:.0%}"
        )
    explained = c.convention is not None and c.typical > TOLERANCE[0] and c.convention[1] < CLEARER * c.typical
    if explained or c.typical >= TOLERANCE[1]:
        reasons.append(f"points misplaced by {100 * c.typical:.1f} cm (median)")
    if c.contradicting > 0.5:
        reasons.append(f"{c.contradicting:.0%} of the pairs of frames contradict the poses")
    return reasons


Refusal = tuple[str, str, list[str], str]
"""What is wrong, what was expected, what was found beside the reasons, and what to do."""


def _late_depth(c: Comparison, reasons: Sequence[str]) -> Refusal | None:
    """The depth images are of other frames: depth alone says so clearly."""
    if (not reasons and c.typical <= TOLERANCE[0]) or _convention(c, reasons):
        return None
    limit = min(TOLERANCE[0], CLEARER * c.by_depth)
    found = best_of(of_depth_images(), c.T, lambda T: _by_depth_alone(c.edges, c.evidence, T), limit)
    if found is None:
        return None
    moved = f"{100 * found[1]:.1f} cm with the depth images moved back, {100 * c.typical:.1f} cm as they are"
    return found[0].name, "colour, depth and pose of one instant in each frame", [moved], found[0].hint


def _colour_of_other_depth(c: Comparison, reasons: Sequence[str]) -> Refusal | None:
    """Poses and depth agree, and the colour shows something else."""
    if not reasons or _convention(c, reasons) or c.by_depth >= TOLERANCE[0] or has_own_depth(c.evidence.views, c.seed):
        return None
    return (
        "the colour images belong to other depth images than those they are named with",
        "colour and depth of the same view",
        [f"without colour, poses and depth agree to {100 * c.by_depth:.1f} cm"],
        "check that colour and depth come from one capture and carry the same numbers or times",
    )


def _contradiction(c: Comparison, reasons: Sequence[str]) -> Refusal | None:
    """The poses are wrong: by a convention, by being of several places, or for no reason that is known."""
    if not reasons:
        return None
    text = "the given poses contradict the depth"
    expected = "camera to world, OpenCV camera axes (x right, y down, z forward), metres"
    if found := _convention(c, reasons):
        hypothesis, left = found
        undone = f"{100 * left:.1f} cm with {hypothesis.name} undone"
        return f"{text}: they look like {hypothesis.name}", expected, [undone], hypothesis.hint
    if c.several_places:
        return f"{text}: they look like poses of more than one place", expected, [], _leave(c.frames, c.pieces[0])
    return text, expected, [], _way_out(c.by_depth)


REFUSALS: tuple[Callable[[Comparison, Sequence[str]], Refusal | None], ...] = (
    _late_depth,
    _colour_of_other_depth,
    _contradiction,
)
"""In this order; the first that applies is what the person is told."""


def _convention(c: Comparison, reasons: Sequence[str]) -> tuple[Hypothesis, float] | None:
    """The reading that explains it, unless the depth agrees with the poses as they are: then it is not a convention."""
    if reasons and c.convention and c.by_depth < TOLERANCE[0] < c.convention[1]:
        return None
    return c.convention


def _warnings(c: Comparison) -> Iterator[str]:
    """What a person should know of poses that are used."""
    if not c.convention and c.typical > TOLERANCE[0] and c.by_depth < CLEARER * c.typical:
        yield (
            f"features of the colour images contradict the poses ({100 * c.typical:.1f} cm), depth does not "
            f"({100 * c.by_depth:.1f} cm): is the colour of another capture or time, or not registered to depth?"
        )
    if c.convention and c.typical > 0.02:
        yield f"poses agree only roughly ({100 * c.typical:.1f} cm); {c.convention[0].name} would explain it"
    if (alone := len(c.frames) - int(c.bad.sum()) - sum(map(len, c.pieces))) > 0:
        yield f"{alone} frames share no surface with others that are used: their poses could not be checked"
    if len(c.pieces) > 1:
        names = " and ".join(_span(c.frames, p) for p in c.pieces[:4])
        yield (
            f"nothing that the frames show joins {names}: their poses to each other could not be checked; "
            "are they of one place?"
        )


def measure_scale(evidence: Evidence, T_world_camera: F64) -> tuple[float, float]:
    """What positions that are right up to scale must be multiplied by to be in the depth's metres, and the relative
    standard error of it: baselines of neighbouring frames by features with depth, against those of the poses.

    Raises:
        PoseError: fewer than 8 pairs of frames match that are 10 cm apart.
    """
    n = len(T_world_camera)
    matched = evidence.matches([(i, i + step) for step in (1, 2, 3) for i in range(n - step)])
    none = np.zeros((0, 3))
    scale, error = _scale([ComparedPair(m.i, m.j, none, none, m.T_i_j[:3, 3]) for m in matched], T_world_camera)
    if scale is None:
        raise PoseError(
            "the scale of the given poses cannot be determined",
            expected="at least 8 pairs of neighbouring frames, 10 cm apart, that share features",
            found=f"{len(matched)} pairs that match",
            hint="have the poses estimated (--poses estimate)",
        )
    return scale, error / scale


def _edges(evidence: Evidence, T: F64, seed: int) -> list[ComparedPair]:
    pairs = choose_pairs(evidence.views, T)
    matched = {(m.i, m.j): m for m in keep_plausible(evidence, pairs, T)}
    rng = np.random.default_rng(seed)
    samples = [sample_surface(view, rng, 100)[0] for view in evidence.views]
    out = []
    for i, j in pairs:
        m = matched.get((i, j))
        if m is not None:
            some = np.unique(np.linspace(0, len(m.a) - 1, 60).astype(int))
            p, q = evidence.views[i].points[m.a[some]], evidence.views[j].points[m.b[some]]
            out.append(ComparedPair(i, j, p, q, m.T_i_j[:3, 3]))
        else:
            out.append(ComparedPair(i, j, samples[i], samples[j], None))
    return out


def _errors(edges: Sequence[ComparedPair], evidence: Evidence, T: F64, share: float = 0.5) -> F64:
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


def _by_depth_alone(edges: Sequence[ComparedPair], evidence: Evidence, T: F64) -> float:
    """Median misplacement by depth of the pairs that features speak of; infinite where it cannot be told."""
    rng = np.random.default_rng(0)
    matched = [e for e in edges if e.t is not None]
    seen = [[sample_surface(evidence.views[k], rng, 100)[0] for k in (e.i, e.j)] for e in matched]
    bare = [ComparedPair(e.i, e.j, p, q, None) for e, (p, q) in zip(matched, seen, strict=True)]
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
    links = agreeing[~bad[agreeing].any(axis=1)]
    piece = linked(links[:, 0], links[:, 1], n)
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
            bad[k] = len(points) > 0 and share_in_image(evidence.views, T, k - 1, np.array([k + 1]), points)[0] > 0.3
    return bad


def _scale(edges: Sequence[ComparedPair], T: F64) -> tuple[float | None, float]:
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


def _explain(
    edges: Sequence[ComparedPair], evidence: Evidence, T: F64, typical: float, scale: float | None
) -> tuple[Hypothesis, float] | None:
    """The reading of the poses that agrees best and the median misplacement it leaves, if it clearly beats none."""
    certain = [e for e in edges if e.t is not None]
    # By depth alone, only frames next to each other surely see the same; poses do not decide who is compared.
    certain = certain if len(certain) >= 8 else [e for e in edges if e.j - e.i <= 3]
    if not certain or typical < 0.02:
        return None

    def misplaced(other: F64) -> float:
        error = _errors(certain, evidence, other)
        # A convention under which frames no longer see each other explains nothing.
        return float(np.nanmedian(error)) if np.isfinite(error).mean() >= 0.7 else float("inf")

    return best_of(of_poses(scale), T, misplaced, min(0.5 * typical, TOLERANCE[1]))


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
