"""Selects reliable pairs of frames where places look alike: neighbours first, then loops that pass all checks.

Frames that follow each other and match are linked; that is a chain of pieces whose shape is known but for a slow drift.
A link between frames far apart in the sequence is a claim: one door looks like the next. Claims that place one piece
(or one part of it) on another in the same way are one loop. A loop is believed if enough independent frames say so,
more than say otherwise; if it asks for no more than the drift that a chain has; and if, once it is closed, no surface
stands where another frame looked through. Pieces that nothing joins stay apart and are reported.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from realsim.errors import PoseError
from realsim.feedforward.rgbd.graph import Edge, components, optimise, spanning_poses
from realsim.feedforward.rgbd.overlap import overlap
from realsim.feedforward.rgbd.pairs import MIN_AGREEMENT, MIN_OVERLAP, WINDOW
from realsim.feedforward.rgbd.tracks import View
from realsim.geometry import angle_deg, invert_T
from realsim.types import F64

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
"""Independent links, each of other frames on both sides, that a loop within a piece needs."""
ASKED = 12
"""Pairs of frames that are asked whether a closed loop violates free space."""


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
        return (
            SLACK_M + DRIFT * abs(self.way[b] - self.way[a]),
            SLACK_DEG + TURN_DRIFT * abs(self.turn[b] - self.turn[a]),
        )


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
    chains, kept = _chains(n, edges)
    links = [e for e in edges if e.j - e.i > 1 and not any(e is k for k in kept)]
    believed: list[Edge] = []
    honest = {far: _honest(chains, edges, far) for far in (False, True)}
    # Where no such link can be checked, a sequence in order is not broken for likeness; one without order has no more.
    ordered = 2 * sum(e.j - e.i == 1 for e in edges) > n - 1

    def trusted(e: Edge) -> bool:
        told = honest[e.j - e.i > WINDOW]
        return told if told is not None else not ordered

    between = [e for e in links if chains.piece[e.i] != chains.piece[e.j]]
    refused = [e for e in between if not trusted(e)]
    inside = [e for e in links if chains.piece[e.i] == chains.piece[e.j]]
    links = inside + [e for e in between if trusted(e)]
    for loop in _between(views, chains, links):
        believed += loop.edges
    for loop, good in _within(views, chains, links):
        (believed if good else refused).extend(loop.edges)
    return _placed(n, kept + believed, refused)


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


def _solved(used: NDArray[np.int64], edges: Sequence[Edge]) -> tuple[list[Edge], F64, NDArray[np.bool_]]:
    """Edges of a connected part, its poses, and which edges contradict them."""
    local = {int(v): k for k, v in enumerate(used)}
    inner = [e for e in edges if e.i in local]
    here = [Edge(local[e.i], local[e.j], e.T_i_j, e.weight, e.root) for e in inner]
    T, chi = optimise(spanning_poses(len(used), here), here)
    return inner, T, chi > max(EDGE_LIMIT, 4 * float(np.median(chi))) if len(chi) else np.zeros(0, bool)


def _chains(n: int, edges: Sequence[Edge]) -> tuple[Chains, list[Edge]]:
    """Pieces by neighbours in the sequence, the closest first, and the edges that hold them.

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
            kept += here
        chains = _chained(n, kept)
    return chains, kept


def _honest(chains: Chains, edges: Sequence[Edge], far: bool) -> bool | None:
    """Whether links of a kind (near in the sequence or far) that the chains can check are true more often than not.

    Where most things that look alike are not the same, another likeness proves nothing. None: none can be checked.
    """
    inside = [e for e in edges if chains.piece[e.i] == chains.piece[e.j] and e.j - e.i > 1]
    true = [_drifted(chains, e) for e in inside if (e.j - e.i > WINDOW) == far]
    return 2 * sum(true) >= len(true) if true else None


def _chained(n: int, edges: list[Edge]) -> Chains:
    """Poses of every connected part."""
    piece, T = np.zeros(n, np.int64), np.tile(np.eye(4), (n, 1, 1))
    for k, part in enumerate(components(n, edges)):
        piece[part] = k
        if len(part) > 1:
            T[part] = _solved(part, edges)[1]
    step, turn = np.zeros(n), np.zeros(n)
    for i in range(1, n):
        before = np.flatnonzero(piece[:i] == piece[i])
        if len(before):
            D = invert_T(T[before[-1]]) @ T[i]
            step[i], turn[i] = np.linalg.norm(D[:3, 3]), angle_deg(D[:3, :3])
    return Chains(piece, T, np.cumsum(step), np.cumsum(turn))


def _loops(chains: Chains, links: Sequence[Edge]) -> list[Loop]:
    """Links of the same two pieces that agree with each other, the best supported first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    groups = defaultdict(list)
    for e in links:
        a, b = int(chains.piece[e.i]), int(chains.piece[e.j])
        groups[min(a, b), max(a, b)].append(e if a <= b else _turned(e))
    out = []
    for group in groups.values():
        pairs = [(x, y) for x in range(len(group)) for y in range(x) if _agree(chains, group[x], group[y])]
        rows, cols = (np.array(c, int) for c in (zip(*pairs, strict=True) if pairs else ((), ())))
        graph = coo_matrix((np.ones(len(rows)), (rows, cols)), (len(group), len(group)))
        label = connected_components(graph, directed=False)[1]
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


def _between(views: Sequence[View], chains: Chains, links: Sequence[Edge]) -> Iterable[Loop]:
    """Joins pieces, the best supported first; `chains` follows."""
    while True:
        open_ = [e for e in links if chains.piece[e.i] != chains.piece[e.j]]
        loops = _loops(chains, open_)
        for loop in loops:
            first = loop.edges[0]
            a, b = chains.piece[first.i], chains.piece[first.j]
            rivals = sum(o.support for o in loops if o is not loop and _same(chains, o, loop))
            small = min((chains.piece == a).sum(), (chains.piece == b).sum())
            # A piece of one or two frames cannot say more than once what a longer one has to say twice.
            if loop.support < min(2, small) or loop.support <= rivals:
                continue
            best = max(loop.edges, key=lambda e: e.weight)
            X = chains.T[best.i] @ best.T_i_j @ invert_T(chains.T[best.j])
            moved = chains.piece == b
            after = chains.T.copy()
            after[moved] = X @ after[moved]
            if not _free(views, after, np.flatnonzero(chains.piece == a), np.flatnonzero(moved), loop):
                continue
            chains.T, chains.piece = after, np.where(moved, a, chains.piece)
            yield loop
            break
        else:
            return


def _same(chains: Chains, a: Loop, b: Loop) -> bool:
    """Whether two loops are about the same two pieces."""
    pieces = [{int(chains.piece[e.i]), int(chains.piece[e.j])} for e in (a.edges[0], b.edges[0])]
    return pieces[0] == pieces[1]


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
    asked = []
    for i in left[np.argsort(np.abs(left[:, None] - at).min(1), kind="stable")][:ASKED]:
        away = np.linalg.norm(T[right, :3, 3] - T[i, :3, 3], axis=1) + 1 - T[right, :3, 2] @ T[i, :3, 2]
        asked += [(int(i), int(j)) for j in right[np.argsort(away, kind="stable")][:2]]
    fits = []
    for i, j in asked:
        if (min(i, j), max(i, j)) not in own:
            fit = overlap(views[i], views[j], invert_T(T[i]) @ T[j], 4)
            if fit.fraction > MIN_OVERLAP:
                fits.append(fit.agreement)
    # Drift that is still to be spread over the loop costs some agreement.
    return len(fits) < 3 or float(np.median(fits)) > 0.7 * MIN_AGREEMENT
