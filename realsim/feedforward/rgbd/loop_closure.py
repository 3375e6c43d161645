"""Selects reliable pairs of frames where places look alike: neighbours first, then loops that pass all checks.

Frames that follow each other and match are linked; that is a chain of pieces whose shape is known but for a slow drift.
A link between frames far apart in the sequence is a claim: one door looks like the next. Claims that place one piece
(or one part of it) on another in the same way are one loop. A loop is believed if enough independent frames say so,
more than say otherwise; if it asks for no more than the drift that a chain has, and for no jump between frames that
follow each other; and if, once it is closed, no surface stands where another frame looked through. Whether likeness can
be trusted at all is measured on the claims that chains can check. Pieces that nothing joins stay apart, with a warning.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import PoseError
from realsim.core.geometry import angle_deg, invert_T, transform
from realsim.core.meshes import linked
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import Evidence, Match, View
from realsim.feedforward.rgbd.matching import MIN_AGREEMENT, MIN_OVERLAP, WINDOW, make_edge
from realsim.feedforward.rgbd.overlap import overlap
from realsim.feedforward.rgbd.pose_graph import Edge, chain_poses, components, optimise

EDGE_LIMIT = 6.0
"""Standard deviations beyond which a pair contradicts the graph and is left out."""
DRIFT = 0.04
"""Share of the way by which a chain of matched frames may be off. Set from a real corridor of 67 m (pieces of up to 57
frames agree with the phone's tracking to 9 cm in 25 m) and rendered ones: ten times what they show."""
SLACK_M, SLACK_DEG = 0.06, 3.0
"""Metres and degrees that two links of one loop may differ by without any way between them."""
TURN_DRIFT = 0.04
"""Share of all turning by which a chain may be turned, degrees a degree."""
LINKS = 3
"""Independent links, each of other frames on both sides, that a loop within a piece needs; false ones that show that
likeness errs."""
ASKED = 12
"""Pairs of frames that are asked whether a closed loop violates free space."""
PACE = 1.25
"""Times the longest step of the chains that frames across a break may be apart, a step: a person walks on as before."""
LEAP = 1.5
"""Times the length of all but the longest tenth of steps, from which a link to the next frame is a claim as well. Set
on a rendered corridor with a gap, where a false link across it makes a step twice as long as the others."""
HONEST = 0.75
"""Least share of true links of a kind, among those that can be checked, where the others are worth looking at. In
rendered corridors and stairwells 0 to 15 of 100 far links are true, of walks around a terrain all."""
PROVEN, PROVEN_SHARE = 20, 0.95
"""Links that could be checked, and the share of true ones, from which looking alike is being the same: one link needs
no second, and no step is too long."""
SURER = 3.0
"""Times as far as a chain of matches that agree with given poses is off by, beyond which a match that contradicts it is
false: what is true of each step of a way is true of its ends, but for levers and slack. Not tuned: likeness errs by a
bay or a stake (0.2 to 2.6 m in rendered places), poses in another unit by as much as their steps add up to."""
ROUGH = 1e-4
"""Metres and radians to which chains are solved: a hundredth of what they may be off by, in a third of the steps."""
STEPS = range(1, WINDOW + 2)
"""Kinds of links: this many steps apart in the sequence; the last are all that are more than the window."""


def drift(way: float, turn: float) -> tuple[float, float]:
    """Metres and degrees by which matched frames may be off after this many metres and degrees."""
    return SLACK_M + DRIFT * way, SLACK_DEG + TURN_DRIFT * turn


@dataclass(frozen=True)
class Loop:
    """Links that say the same."""

    edges: list[Edge]

    @property
    def support(self) -> int:
        """Number of independent links, with different frames on both sides."""
        return min(len({e.i for e in self.edges}), len({e.j for e in self.edges}))

    @property
    def rank(self) -> tuple[int, float]:
        return self.support, sum(e.weight for e in self.edges)


@dataclass
class Chains:
    """Pieces of the sequence, each with poses of its own."""

    piece: NDArray[np.int64]
    """(N,) which piece a frame belongs to."""
    T: F64
    """(N, 4, 4) poses in the piece's own world."""
    way: F64
    """(N,) metres along the sequence, pieces after one another."""
    turn: F64
    """(N,) degrees turned along the sequence."""

    def apart(self, a: int, b: int) -> tuple[float, float]:
        """Metres and degrees by which the motion from frame a to frame b of one piece may be off."""
        return drift(abs(self.way[b] - self.way[a]), abs(self.turn[b] - self.turn[a]))


@dataclass(frozen=True)
class Joined:
    """Connected components."""

    used: NDArray[np.int64]
    """(M,) frames of the largest part, in order."""
    T: F64
    """(M, 4, 4) poses, the first frame's camera is the world."""
    edges: list[Edge]
    """Believed, between frames of this part."""
    parts: list[NDArray[np.int64]]
    """All parts, the largest first."""
    refused: list[Edge] = field(default_factory=list)
    """Links between frames far apart in the sequence that were not believed."""


def join(views: Sequence[View], edges: Sequence[Edge]) -> Joined:
    """Poses of the largest set of views that can be joined.

    Raises:
        PoseError: fewer than two views hang together.
    """
    n = len(views)
    ordered = is_in_order(n, edges)
    chains, kept = _chains(n, edges, steady=False)
    pace = _pace(kept) if ordered and not _proven(chains, edges, np.inf, ordered) else np.inf
    if np.isfinite(pace) and any(_checked(chains, edges, step, pace)[1] for step in STEPS):
        chains, kept = _chains(n, edges, steady=True)
        pace = _pace(kept)
    fixed = _pairs(kept)
    links = [e for e in edges if (e.i, e.j) not in fixed]
    checked = [_checked(chains, edges, step, pace) for step in STEPS]

    def trusted(e: Edge) -> bool:
        """Where things that look alike are often not the same, another likeness proves nothing. Where no likeness can
        be checked, a sequence in order is not broken for one; a sequence without order has nothing else."""
        true, false = checked[_step(e) - 1]
        return true >= HONEST * (true + false) if true + false else not ordered

    between = [e for e in links if chains.piece[e.i] != chains.piece[e.j]]
    refused = [e for e in between if not trusted(e)]
    links = [e for e in links if chains.piece[e.i] == chains.piece[e.j] or trusted(e)]
    believed: list[Edge] = []
    for loop in _between(views, chains, links, 2, pace):
        believed += loop.edges
    if _proven(chains, edges, pace, ordered):
        for loop in _between(views, chains, links, 1, pace):
            believed += loop.edges
    joined = _pairs(believed)
    for loop, good in _within(views, chains, [e for e in links if (e.i, e.j) not in joined]):
        (believed if good else refused).extend(loop.edges)
    return _placed(n, kept + believed, refused)


def keep_plausible(evidence: Evidence, pairs: Sequence[tuple[int, int]], T: F64) -> list[Match]:
    """Verified matches of pairs i < j, without those that other matches rule out: one door looks like the next.

    Two chains can: that of neighbours, whatever the poses T (N, 4, 4) are, so that what is left may judge them (where
    neighbours do not agree with each other, as with depth of another time, there is none); and that of matches that
    agree with T. Poses that are wrong do not agree with many independent matches by chance.
    """
    found = evidence.matches(pairs)
    edges = [make_edge(m) for m in found]
    n = len(evidence.views)
    chains, kept = _chains(n, edges, steady=False)
    near = [e for e in edges if 1 < e.j - e.i <= WINDOW]
    agree = sum(e.j - e.i > 1 for e in kept)
    if is_in_order(n, edges) and agree >= HONEST * len(near):
        apart = [chains.piece[e.i] != chains.piece[e.j] for e in edges]
        found = [m for m, e, open_ in zip(found, edges, apart, strict=True) if open_ or _drifted(chains, e)]
    return _borne_out(evidence, found, T)


def _borne_out(evidence: Evidence, found: list[Match], T: F64) -> list[Match]:
    """Without matches that put their frames farther from where T has them than a way between the two, along matches
    that agree with T, can be off by. Where many are false, those that no such way can check say nothing either."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    i, j = np.array([(m.i, m.j) for m in found], int).reshape(-1, 2).T
    # Median distance of the matched points under poses T from where the match has them, metres.
    off = np.zeros(len(found))
    for k, m in enumerate(found):
        p = evidence.views[m.i].points[m.a]
        moved = transform(invert_T(T[m.j]) @ T[m.i], p) - transform(invert_T(m.T_i_j), p)
        off[k] = np.median(np.linalg.norm(moved, axis=1))
    sure = off < SLACK_M
    way = dijkstra(coo_matrix((off[sure] + 1e-6, (i[sure], j[sure])), (len(T), len(T))).tocsr(), directed=False)
    false = off > SLACK_M + SURER * way[i, j]
    if false.sum() >= LINKS and sure.sum() < HONEST * (sure | false).sum():
        false = ~sure
    return [m for m, out in zip(found, false, strict=True) if not out]


def is_in_order(n: int, edges: Sequence[Edge]) -> bool:
    """Whether the sequence is a way through the place: most frames match the next."""
    return 2 * sum(e.j - e.i == 1 for e in edges) > n - 1


def _pairs(edges: Sequence[Edge]) -> set[tuple[int, int]]:
    return {(min(e.i, e.j), max(e.i, e.j)) for e in edges}


def _pace(kept: Sequence[Edge]) -> float:
    """Metres that two frames may be apart for each step between them in the sequence."""
    steps = [float(np.linalg.norm(e.T_i_j[:3, 3])) for e in kept if e.j - e.i == 1]
    return PACE * max(steps, default=np.inf)


def _placed(n: int, edges: list[Edge], refused: list[Edge]) -> Joined:
    """The largest connected part and its poses, without edges that contradict the rest."""
    while True:
        parts = components(n, edges)
        used = parts[0]
        if len(used) < 2:
            raise PoseError(
                "the frames cannot be connected",
                expected="neighbouring frames that see the same surfaces, with texture or shape in common",
                found=f"no two of {n} frames that fit together",
                hint="move the camera by less than a third of the picture between frames, or give poses",
            )
        inner, T, wrong = _solved(used, edges)
        if not wrong.any():
            return Joined(used, T, inner, parts, refused)
        bad = {id(e) for e, w in zip(inner, wrong, strict=True) if w}
        edges = [e for e in edges if id(e) not in bad]


def _solved(
    used: NDArray[np.int64], edges: Sequence[Edge], tolerance: float = 1e-8
) -> tuple[list[Edge], F64, NDArray[np.bool_]]:
    """Edges of a connected part, its poses, and which edges contradict them."""
    local = {int(v): k for k, v in enumerate(used)}
    inner = [e for e in edges if e.i in local]
    here = [Edge(local[e.i], local[e.j], e.T_i_j, e.weight, e.root) for e in inner]
    T, chi = optimise(chain_poses(len(used), here), here, tolerance=tolerance)
    return inner, T, chi > max(EDGE_LIMIT, 4 * float(np.median(chi))) if len(chi) else np.zeros(0, bool)


def _chains(n: int, edges: Sequence[Edge], steady: bool) -> tuple[Chains, list[Edge]]:
    """Pieces by neighbours in the sequence, the closest first, and the edges that hold them; `steady`: without leaps.

    The nearer two frames are in the sequence, the less another place can pass for the one that they share: links one
    step apart make the chain, links of more steps have to agree with it.
    """
    kept: list[Edge] = []
    chains = Chains(np.arange(n), np.tile(np.eye(4), (n, 1, 1)), np.zeros(n), np.zeros(n))
    for step in range(1, WINDOW + 1):
        here = [e for e in edges if e.j - e.i == step]
        inside = [e for e in here if chains.piece[e.i] == chains.piece[e.j]]
        kept += [e for e in inside if _drifted(chains, e)]
        if step == 1:
            length = np.array([np.linalg.norm(e.T_i_j[:3, 3]) for e in here])
            limit = LEAP * np.quantile(length, 0.9) + SLACK_M if steady and len(here) else np.inf
            kept += [e for e, m in zip(here, length, strict=True) if m < limit]
        chains = _chained(n, kept)
    return chains, kept


def _proven(chains: Chains, edges: Sequence[Edge], pace: float, ordered: bool) -> bool:
    """Whether what looks alike in this place is the same. Of a sequence in order only links far apart can show it."""
    true, false = np.sum([_checked(chains, edges, step, pace) for step in (STEPS[-1:] if ordered else STEPS)], axis=0)
    return bool(true >= PROVEN and true >= PROVEN_SHARE * (true + false))


def _step(e: Edge) -> int:
    """Steps between two frames in the sequence; all that are more than the window are one kind."""
    return min(e.j - e.i, WINDOW + 1)


def _checked(chains: Chains, edges: Sequence[Edge], step: int, pace: float) -> tuple[int, int]:
    """Numbers of links of each length in steps that the chains show to be true, and to be false.

    Inside a piece a link agrees with the chain or not. Between pieces it is false if it asks for a jump.
    """
    links = [e for e in edges if _step(e) == step]
    inside = [_drifted(chains, e) for e in links if chains.piece[e.i] == chains.piece[e.j]]
    jumps = [_jumps(chains, _moved(chains, e), e, pace) for e in links if chains.piece[e.i] != chains.piece[e.j]]
    return sum(inside), len(inside) - sum(inside) + sum(jumps)


def _moved(chains: Chains, e: Edge) -> F64:
    """(N, 4, 4) poses with the second frame's piece put where a link says."""
    X = chains.T[e.i] @ e.T_i_j @ invert_T(chains.T[e.j])
    second = chains.piece == chains.piece[e.j]
    after = chains.T.copy()
    after[second] = X @ after[second]
    return after


def _jumps(chains: Chains, T: F64, e: Edge, pace: float) -> bool:
    """Whether two frames that follow each other, of the two pieces that a link joins, are too far apart in T."""
    both = np.flatnonzero(np.isin(chains.piece, [chains.piece[e.i], chains.piece[e.j]]))
    turn = np.flatnonzero(np.diff(chains.piece[both]))
    a, b = both[turn], both[turn + 1]
    apart = np.linalg.norm(T[b, :3, 3] - T[a, :3, 3], axis=1)
    return bool((apart > pace * (b - a) + SLACK_M).any())


def _chained(n: int, edges: list[Edge]) -> Chains:
    """Poses of every connected part."""
    piece, T = np.zeros(n, np.int64), np.tile(np.eye(4), (n, 1, 1))
    for k, part in enumerate(components(n, edges)):
        piece[part] = k
        if len(part) > 1:
            T[part] = _solved(part, edges, ROUGH)[1]
    step, turn = np.zeros(n), np.zeros(n)
    for i in range(1, n):
        before = np.flatnonzero(piece[:i] == piece[i])
        if len(before):
            D = invert_T(T[before[-1]]) @ T[i]
            step[i], turn[i] = np.linalg.norm(D[:3, 3]), angle_deg(D[:3, :3])
    return Chains(piece, T, np.cumsum(step), np.cumsum(turn))


def _loops(chains: Chains, links: Sequence[Edge]) -> list[Loop]:
    """Links of the same two pieces that agree with each other, the best supported first."""
    groups = defaultdict(list)
    for e in links:
        a, b = int(chains.piece[e.i]), int(chains.piece[e.j])
        groups[min(a, b), max(a, b)].append(e if a <= b else _turned(e))
    out = []
    for group in groups.values():
        pairs = [(x, y) for x in range(len(group)) for y in range(x) if _agree(chains, group[x], group[y])]
        label = linked([x for x, _ in pairs], [y for _, y in pairs], len(group))
        out += [Loop([group[k] for k in np.flatnonzero(label == m)]) for m in range(label.max() + 1)]
    return sorted(out, key=lambda loop: loop.rank, reverse=True)


def _turned(e: Edge) -> Edge:
    return Edge(e.j, e.i, invert_T(e.T_i_j), e.weight, e.root)


def _agree(chains: Chains, e: Edge, f: Edge) -> bool:
    """Whether going by e, along the one piece, back by f and along the other ends where it began."""
    T = chains.T
    cycle = e.T_i_j @ invert_T(T[e.j]) @ T[f.j] @ invert_T(f.T_i_j) @ invert_T(T[f.i]) @ T[e.i]
    (m1, d1), (m2, d2) = chains.apart(e.i, f.i), chains.apart(e.j, f.j)
    return bool(np.linalg.norm(cycle[:3, 3]) < max(m1, m2) and angle_deg(cycle[:3, :3]) < max(d1, d2))


def _between(views: Sequence[View], chains: Chains, links: Sequence[Edge], least: int, pace: float) -> Iterable[Loop]:
    """Joins pieces that at least `least` independent links join, the best supported first; `chains` follows."""
    while True:
        open_ = [e for e in links if chains.piece[e.i] != chains.piece[e.j]]
        loops = _loops(chains, open_)

        def joins(loop: Loop) -> set[int]:
            """The two pieces that a loop is about."""
            return {int(chains.piece[k]) for k in (loop.edges[0].i, loop.edges[0].j)}

        for loop in loops:
            first = loop.edges[0]
            a, b = chains.piece[first.i], chains.piece[first.j]
            rivals = sum(o.support for o in loops if o is not loop and joins(o) == {a, b})
            small = min((chains.piece == a).sum(), (chains.piece == b).sum())
            # A piece of one or two frames cannot say more than once what a longer one has to say twice.
            if loop.support < min(least, small) or loop.support <= rivals:
                continue
            best = max(loop.edges, key=lambda e: e.weight)
            moved = chains.piece == b
            after = _moved(chains, best)
            if _jumps(chains, after, best, pace) or not _free(
                views, after, np.flatnonzero(chains.piece == a), np.flatnonzero(moved), loop
            ):
                continue
            chains.T, chains.piece = after, np.where(moved, a, chains.piece)
            yield loop
            break
        else:
            return


def _within(views: Sequence[View], chains: Chains, links: Sequence[Edge]) -> Iterable[tuple[Loop, bool]]:
    """Loops inside a piece, and whether each is believed."""
    for loop in _loops(chains, [e for e in links if chains.piece[e.i] == chains.piece[e.j]]):
        likely = [e for e in loop.edges if _drifted(chains, e)]
        small = Loop(likely)
        believed = len(likely) * 2 > len(loop.edges) and (
            small.support >= LINKS or all(abs(chains.way[e.j] - chains.way[e.i]) < SLACK_M / DRIFT for e in likely)
        )
        if believed:
            e = max(likely, key=lambda e: e.weight)
            after = chains.T.copy()
            later = np.arange(len(views)) >= max(e.i, e.j)
            a, b = (e.i, e.j) if e.i < e.j else (e.j, e.i)
            motion = e.T_i_j if e.i < e.j else invert_T(e.T_i_j)
            after[later] = after[a] @ motion @ invert_T(after[b]) @ after[later]
            mine = chains.piece == chains.piece[e.i]
            believed = _free(views, after, np.flatnonzero(mine & ~later), np.flatnonzero(mine & later), small)
        yield (small if believed else loop), believed


def _drifted(chains: Chains, e: Edge) -> bool:
    """Whether a link asks for no more than the drift of the chain between its frames."""
    E = invert_T(e.T_i_j) @ invert_T(chains.T[e.i]) @ chains.T[e.j]
    metres, degrees = chains.apart(e.i, e.j)
    return bool(np.linalg.norm(E[:3, 3]) < metres and angle_deg(E[:3, :3]) < degrees)


def _free(views: Sequence[View], T: F64, left: NDArray[np.int64], right: NDArray[np.int64], loop: Loop) -> bool:
    """Whether frames on both sides of a closed loop agree about free space, near it and apart from its own links."""
    own = {(min(e.i, e.j), max(e.i, e.j)) for e in loop.edges}
    at = np.array([e.i for e in loop.edges] + [e.j for e in loop.edges])
    candidates = []
    for i in left[np.argsort(np.abs(left[:, None] - at).min(1), kind="stable")][:ASKED]:
        away = np.linalg.norm(T[right, :3, 3] - T[i, :3, 3], axis=1) + 1 - T[right, :3, 2] @ T[i, :3, 2]
        candidates += [(int(i), int(j)) for j in right[np.argsort(away, kind="stable")][:2]]
    fits = []
    for i, j in candidates:
        if (min(i, j), max(i, j)) not in own:
            fit = overlap(views[i], views[j], invert_T(T[i]) @ T[j], 4)
            if fit.fraction > MIN_OVERLAP:
                fits.append(fit.agreement)
    # Drift that is still to be spread over the loop costs some agreement.
    return len(fits) < 3 or float(np.median(fits)) > 0.7 * MIN_AGREEMENT
