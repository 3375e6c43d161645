"""Do given poses agree with what the frames show?

Compared are pairs of frames: by how many metres the poses misplace one frame's points in the other. Where two frames
share verified features, these are the same points; elsewhere it is depth against depth where the poses say that both
look. A few frames with wrong poses are named so that they can be dropped. Poses that are wrong as a whole are refused,
and the table of hypotheses.py says what they look like.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import PoseError
from realsim.core.geometry import invert_T, transform
from realsim.core.meshes import linked
from realsim.core.types import F64, Bool, Dropped, Frame
from realsim.feedforward.rgbd import hypotheses
from realsim.feedforward.rgbd.features import Evidence, View
from realsim.feedforward.rgbd.hypotheses import Explanation, explain
from realsim.feedforward.rgbd.loop_closure import LINKS, keep_plausible
from realsim.feedforward.rgbd.refine_pairs import choose_pairs, look_up, sample_surface, share_in_image

TOLERANCE = (0.05, 0.12)
"""Metres: a pair contradicts beyond four times the median pair, but within these. Handheld trackers are off by 1 to
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
BY_DEPTH = 0.3
"""Weight of a pair without features against one with."""


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of the poses with the frames."""

    agreement: F64
    """(N,) share of a frame's pairs that agree, NaN where no other frame shows the same."""
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
    found = Comparison(frames, evidence or Evidence.of(frames, seed), np.asarray(T_world_camera, float), seed)
    if not found.seen.any():
        explained = explain(hypotheses.of_poses(None), found, TOLERANCE[1])
        if explained is None:
            text = "the poses could not be checked: no two frames show the same surface"
            return PoseCheck(np.full(len(frames), np.nan), (), (text,), {"edges": 0})
        raise PoseError(
            f"with the given poses no two frames show the same surface: they look like {explained[0].name}",
            file=source,
            hint=explained[0].hint,
        )
    reasons = _reasons(found, sensor_sigma)
    if (refusal := _refusal(found, reasons)) is not None:
        text, expected, seen, hint = refusal
        raise PoseError(text, file=source, expected=expected, found="; ".join([*reasons, *seen]), hint=hint)
    return PoseCheck(found.agreement, _named(found), tuple(_warnings(found)), found.statistics)


@dataclass(frozen=True)
class ComparedPair:
    """Points of two frames, each in its own camera and sensor depth."""

    i: int
    j: int
    p: F64
    """(M, 3) camera i."""
    q: F64
    """(M, 3) the same points in camera j by features; else (K, 3) points that j sees. Where `t` is None, points of
    either are looked up in the other's depth."""
    t: F64 | None
    """(3,) position of camera j in camera i, by features and depth alone; None: no features."""


class Comparison:
    """Poses (N, 4, 4) against frames."""

    def __init__(self, frames: Sequence[Frame], evidence: Evidence, T: F64, seed: int) -> None:
        self.frames, self.evidence, self.T, self.seed = frames, evidence, T, seed
        self.pairs = self._compared()
        self.index = np.array([(e.i, e.j) for e in self.pairs]).reshape(-1, 2)
        self.weight = np.array([BY_DEPTH if e.t is None else 1.0 for e in self.pairs])
        self.error = self.misplaced(self.pairs, T, MOST)
        self.seen = np.isfinite(self.error)
        """(E,) pairs that see the same surface by the poses, or share features."""

    def _compared(self) -> list[ComparedPair]:
        views = self.evidence.views
        chosen = choose_pairs(views, self.T)
        matched = {(m.i, m.j): m for m in keep_plausible(self.evidence, chosen, self.T)}
        rng = np.random.default_rng(self.seed)
        samples = [sample_surface(view, rng, 100)[0] for view in views]
        out = []
        for i, j in chosen:
            if (m := matched.get((i, j))) is None:
                out.append(ComparedPair(i, j, samples[i], samples[j], None))
                continue
            some = np.unique(np.linspace(0, len(m.a) - 1, 60).astype(int))
            p, q = views[i].points[m.a[some]], views[j].points[m.b[some]]
            out.append(ComparedPair(i, j, p, q, m.T_i_j[:3, 3]))
        return out

    def misplaced(self, pairs: Sequence[ComparedPair], T: F64, share: float = 0.5) -> F64:
        """Median misplacement of each pair's points under poses T, metres; by depth the one that a `share` of them is
        within. NaN where too little is seen to tell."""
        out, views = np.full(len(pairs), np.nan), self.evidence.views
        for k, e in enumerate(pairs):
            D = invert_T(T[e.j]) @ T[e.i]
            if e.t is not None:
                out[k] = np.median(np.linalg.norm(transform(D, e.p) - e.q, axis=1))
                continue
            off = np.concatenate([_off(views[e.j], transform(D, e.p)), _off(views[e.i], transform(invert_T(D), e.q))])
            if len(off) >= 20:
                out[k] = np.quantile(np.abs(off), share)
        return out

    @cached_property
    def certain(self) -> list[ComparedPair]:
        """Pairs that share features; where few do, those of frames next to each other: poses do not decide who is
        compared."""
        matched = [e for e in self.pairs if e.t is not None]
        return matched if len(matched) >= 8 else [e for e in self.pairs if e.j - e.i <= 3]

    @cached_property
    def bare(self) -> list[ComparedPair]:
        """The pairs that share features, to be compared by depth alone."""
        rng, views = np.random.default_rng(0), self.evidence.views
        matched = [e for e in self.pairs if e.t is not None]
        samples = [[sample_surface(views[k], rng, 100)[0] for k in (e.i, e.j)] for e in matched]
        return [ComparedPair(e.i, e.j, p, q, None) for e, (p, q) in zip(matched, samples, strict=True)]

    @cached_property
    def typical(self) -> float:
        """Metres by which the points that features share are misplaced, the median."""
        certain = self.seen & (self.weight == self.weight[self.seen].max())
        return float(np.median(self.misplaced(self.pairs, self.T)[certain]))

    @property
    def limit(self) -> float:
        """Metres beyond which a pair contradicts the poses."""
        return float(np.clip(4 * self.typical, *TOLERANCE))

    @property
    def contradicting(self) -> float:
        """Share of the pairs that contradict."""
        return float((self.error[self.seen] > self.limit).mean())

    @cached_property
    def per_frame(self) -> tuple[F64, F64]:
        """(N,) of each frame's pairs: the share that agrees, and the median misplacement in metres; NaN without any."""
        agreement, middle = np.full((2, len(self.frames)), np.nan)
        for k in range(len(self.frames)):
            mine = self.seen & (self.index == k).any(1)
            if mine.any():
                agreement[k] = np.average(self.error[mine] <= self.limit, weights=self.weight[mine])
                middle[k] = np.median(self.error[mine])
        return agreement, middle

    @property
    def agreement(self) -> F64:
        return self.per_frame[0]

    @cached_property
    def strangers(self) -> list[list[int]]:
        """Pieces that agree within themselves and contradict the largest where both see the same surface."""
        pieces = self._pieces(np.zeros(len(self.frames), bool))
        # By depth alone: likeness may be false wherever pieces meet. So many pairs see the same surface, none agrees.
        pair = self.index[self.seen & (self.weight < 1)]

        def between(a: list[int], b: list[int]) -> int:
            in_a, in_b = np.isin(pair, a), np.isin(pair, b)
            return int(((in_a[:, 0] & in_b[:, 1]) | (in_b[:, 0] & in_a[:, 1])).sum())

        return [p for p in pieces[1:] if between(p, pieces[0]) >= LINKS]

    @cached_property
    def bad(self) -> Bool:
        """(N,) frames that most others contradict, or that look elsewhere than their neighbours."""
        seen = self.seen
        bad = _greedy(self.index[seen], self.weight[seen], self.error[seen] > self.limit, len(self.frames))
        bad |= _nowhere(self.evidence, self.T, self.agreement)
        bad[[k for p in self.strangers for k in p]] = True
        return bad

    @cached_property
    def pieces(self) -> list[list[int]]:
        """Frames that are not bad and that agreeing pairs join, the largest piece first."""
        return self._pieces(self.bad)

    def _pieces(self, bad: Bool) -> list[list[int]]:
        agreeing = self.index[self.seen & (self.error <= self.limit)]
        links = agreeing[~bad[agreeing].any(axis=1)]
        piece = linked(links[:, 0], links[:, 1], len(self.frames))
        found = [np.flatnonzero((piece == k) & ~bad).tolist() for k in np.unique(piece[~bad])]
        return sorted((p for p in found if len(p) > 1), key=len, reverse=True)

    @cached_property
    def scale(self) -> tuple[float | None, float]:
        """Metres by depth for one by the poses, and its standard error."""
        return _scale([(e.i, e.j, e.t) for e in self.pairs if e.t is not None], self.T)

    @cached_property
    def convention(self) -> Explanation | None:
        """The reading of the poses that agrees best, if it clearly beats them as they are."""
        if not self.certain or self.typical < 0.02:
            return None
        return explain(hypotheses.of_poses(self.scale[0]), self, min(0.5 * self.typical, TOLERANCE[1]))

    @cached_property
    def by_depth(self) -> float:
        """Misplacement by depth alone, metres."""
        return hypotheses.by_depth(self, self.T)

    @property
    def statistics(self) -> dict[str, Any]:
        """JSON-able."""
        scale = self.scale[0]
        return {
            "edges": int(self.seen.sum()),
            "feature_edges": int((self.weight == 1).sum()),
            "typical_m": self.typical,
            "limit_m": self.limit,
            "contradicting_edges": self.contradicting,
            "pose_scale": None if scale is None else 1 / scale,
        }

    def span(self, piece: Sequence[int]) -> str:
        """Frames of a piece in words."""
        return f"{self.frames[piece[0]].name} to {self.frames[piece[-1]].name} ({len(piece)} frames)"


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


def _refusal(c: Comparison, reasons: Sequence[str]) -> tuple[str, str, list[str], str] | None:
    """What is wrong with poses that cannot be used, what was expected, what was found beside the reasons, and what to
    do: a convention, colour of other frames, several places, or nothing that is known."""
    if not reasons:
        return None
    # Where depth agrees with the poses as they are, it is no convention, whatever features say.
    convention = c.convention
    if convention and c.by_depth < TOLERANCE[0] < convention[1]:
        convention = None
    if convention is None and (other := explain(hypotheses.OTHER_COLOUR, c, TOLERANCE[0])):
        without = f"without colour, poses and depth agree to {100 * other[1]:.1f} cm"
        return other[0].name, "colour and depth of the same view", [without], other[0].hint
    text = "the given poses contradict the depth"
    expected = "camera to world, OpenCV camera axes (x right, y down, z forward), metres"
    if convention is not None:
        name = convention[0].name
        undone = f"{100 * convention[1]:.1f} cm with {name} undone"
        return f"{text}: they look like {name}", expected, [undone], convention[0].hint
    many = MANY * len(c.frames)
    if c.bad.sum() > many and c.pieces and len(c.pieces[0]) > many:
        hint = (
            f"of these {c.span(c.pieces[0])} agree with each other: leave out the others if they are of another place, "
            "or estimate the poses (--poses estimate)"
        )
        return f"{text}: they look like poses of more than one place", expected, [], hint
    hint = "estimate the poses from the frames instead (--poses estimate)"
    if c.by_depth <= TOLERANCE[0]:
        hint = (
            f"surfaces agree with the poses to {100 * c.by_depth:.1f} cm, features do not: leave out frames in which "
            "something large moved, or that are of another place, or estimate the poses (--poses estimate)"
        )
    return text, expected, [], hint


def _warnings(c: Comparison) -> Iterator[str]:
    """What a person should know of poses that are used."""
    if not c.convention and c.typical > TOLERANCE[0] and c.by_depth < CLEARER * c.typical:
        yield (
            f"features of the colour images contradict the poses ({100 * c.typical:.1f} cm), depth does not "
            f"({100 * c.by_depth:.1f} cm): is the colour of another capture or time, or not registered to depth?"
        )
    if c.convention and c.typical > 0.02:
        name = c.convention[0].name
        yield f"poses agree only roughly ({100 * c.typical:.1f} cm); {name} would explain it"
    if (alone := len(c.frames) - int(c.bad.sum()) - sum(map(len, c.pieces))) > 0:
        yield f"{alone} frames share no surface with others that are used: their poses could not be checked"
    if len(c.pieces) > 1:
        yield (
            f"nothing that the frames show joins {' and '.join(map(c.span, c.pieces[:4]))}: their poses to each other "
            "could not be checked; are they of one place?"
        )


def _named(c: Comparison) -> tuple[Dropped, ...]:
    """The bad frames, and why each is."""
    out, (agreement, middle) = [], c.per_frame
    of = {k: piece for piece in c.strangers for k in piece}
    for k in np.flatnonzero(c.bad).tolist():
        if k in of:
            reason = (
                f"{c.span(of[k])} agree with each other and with no frame of {c.span(c.pieces[0])}, where by the "
                "poses both see the same surface: of another place, or their poses jump"
            )
        elif np.isnan(agreement[k]):
            reason = "its pose looks at nothing that the frames before and after see"
        else:
            reason = (
                f"its pose contradicts the depth: {100 * (1 - agreement[k]):.0f} percent of the frames it overlaps "
                f"with disagree, by {100 * middle[k]:.1f} cm (median)"
            )
        out.append(Dropped(c.frames[k].name, reason))
    return tuple(out)


def measure_scale(evidence: Evidence, T_world_camera: F64) -> tuple[float, float]:
    """What positions that are right up to scale must be multiplied by to be in the depth's metres, and the relative
    standard error of it: baselines of neighbouring frames by features with depth, against those of the poses.

    Raises:
        PoseError: fewer than 8 pairs of frames match that are 10 cm apart.
    """
    n = len(T_world_camera)
    matched = evidence.matches([(i, i + step) for step in (1, 2, 3) for i in range(n - step)])
    scale, error = _scale([(m.i, m.j, m.T_i_j[:3, 3]) for m in matched], T_world_camera)
    if scale is None:
        raise PoseError(
            "the scale of the given poses cannot be determined",
            expected="at least 8 pairs of neighbouring frames, 10 cm apart, that share features",
            found=f"{len(matched)} pairs that match",
            hint="have the poses estimated (--poses estimate)",
        )
    return scale, error / scale


def _scale(known: Sequence[tuple[int, int, F64]], T: F64) -> tuple[float | None, float]:
    """Metres by depth for a metre by poses, of pairs (i, j, where j stands in i): the median over those with a
    baseline, and its standard error."""
    given = np.array([(invert_T(T[i]) @ T[j])[:3, 3] for i, j, _ in known]).reshape(-1, 3)
    found = np.array([t for _, _, t in known]).reshape(-1, 3)
    long = np.linalg.norm(found, axis=1) > 0.1
    if long.sum() < 8:
        return None, 0.0
    # Lengths, not components: they do not depend on a wrong convention of the axes.
    ratio = np.linalg.norm(found[long], axis=1) / np.maximum(np.linalg.norm(given[long], axis=1), 1e-9)
    middle = np.median(ratio)
    return float(middle), float(1.4826 * np.median(np.abs(ratio - middle)) / np.sqrt(long.sum()) * 1.25)


def _off(view: View, y: F64) -> F64:
    """By how much points y (M, 3) of a view's camera lie behind what it sees there (K,), metres; not those that it
    cannot see because something hides them, which no pose forbids."""
    q, _, ok = look_up(view, y)
    behind = y[ok, 2] - q[ok, 2]
    return behind[behind < TOLERANCE[1]]


def _greedy(pair: np.ndarray, weight: F64, wrong: Bool, n: int) -> Bool:
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


def _nowhere(evidence: Evidence, T: F64, agreement: F64) -> Bool:
    """Frames that overlap with nothing although the frames before and after see the same surface."""
    bad = np.zeros(len(T), bool)
    for k in np.flatnonzero(np.isnan(agreement)).tolist():
        if 0 < k < len(T) - 1:
            z = evidence.views[k - 1].depth
            points = (evidence.views[k - 1].camera.rays() * z[..., None])[z > 0][::97].astype(float)
            bad[k] = len(points) > 0 and share_in_image(evidence.views, T, k - 1, np.array([k + 1]), points)[0] > 0.3
    return bad
