"""Links between frames by the shape of what they see alone, where features leave the sequence in pieces.

A registration that ends in a wrong place often fits: most of what two frames share is floor, which fits everywhere. So
a link by shape is a claim, as a loop is. It may violate free space no more than good links of this capture do, whose
sensor is as noisy; and it needs a second vote: a third frame that is linked to one of its two must confirm where it
puts the other. Either a link between these two, found from its own start, closes the cycle; or their surfaces stay
where the claim puts them when they are registered, without more violation. What no third frame confirms joins nothing.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from realsim.core.geometry import angle_deg, invert_T
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import View
from realsim.feedforward.rgbd.loop_closure import drift, is_in_order
from realsim.feedforward.rgbd.matching import WINDOW, describe_shape, is_ambiguous, propose_starts, register_by_shape
from realsim.feedforward.rgbd.overlap import FINE, overlap
from realsim.feedforward.rgbd.pose_graph import Edge, label_pieces

STEPS = 2
"""Frames that features do not connect are compared by shape with this many that follow."""
VIOLATED, SPARE = 2.0, 0.02
"""Share of impossible depth of a true link: at most this many times that of the better links of its capture (their
first quartile), and this much more. Set on the rendered stake_a, narrow_a and mixed_a without colour, every 3rd and 6th
frame (true: 0 to 0.024, false: 0.026 and more), and on an iPhone's LiDAR (quartile 0.03, true mostly to 0.08, false
0.085 and 0.12). On five rendered places that it was not set on: 134 of 152 true links kept, 0 of 2 false ones; most
of the 18 because no third frame overlaps."""


def link_by_shape(views: Sequence[View], edges: Sequence[Edge], seed: int) -> tuple[list[Edge], list[Edge]]:
    """Links by shape between near frames that `edges` leave in different parts: believed ones, and ones that nothing
    confirms.

    Of a sequence in order the parts are those that neighbours hold: what only looks alike connects nothing.
    """
    n = len(views)
    near = [e for e in edges if e.j - e.i <= WINDOW] if is_in_order(n, edges) else list(edges)
    label = label_pieces(n, near)
    loose = [(i, j) for i in range(n) for j in range(i + 1, min(i + 1 + STEPS, n)) if label[i] != label[j]]
    features = {k: describe_shape(views[k]) for k in sorted({k for pair in loose for k in pair})}
    claims = []
    for i, j in track(loose, "shapes"):
        starts = propose_starts(features[i], features[j], np.random.default_rng((seed, i, j)))
        edge = register_by_shape(views, i, j, starts)
        if edge is not None and not is_ambiguous(views, edge):
            claims.append(edge)
    known = [*near, *claims]
    violation = [_violation(views, e.i, e.j, e.T_i_j) for e in known] if claims else [0.0]
    most = VIOLATED * float(np.quantile(violation, 0.25)) + SPARE
    good = [_confirmed(views, e, known, most) for e in claims]
    return [e for e, g in zip(claims, good, strict=True) if g], [e for e, g in zip(claims, good, strict=True) if not g]


def _violation(views: Sequence[View], i: int, j: int, T_i_j: F64) -> float:
    """Share of the depth of two frames that is impossible at a motion."""
    return 1 - overlap(views[i], views[j], T_i_j).agreement


def _confirmed(views: Sequence[View], claim: Edge, known: Sequence[Edge], most: float) -> bool:
    """Whether a claim leaves free space free, and a third frame bears it out."""
    if _violation(views, claim.i, claim.j, claim.T_i_j) > most:
        return False
    motions: dict[int, dict[int, F64]] = defaultdict(dict)
    for e in known:
        motions[e.i][e.j], motions[e.j][e.i] = e.T_i_j, invert_T(e.T_i_j)
    thirds = [(k, a, b) for a, b in ((claim.i, claim.j), (claim.j, claim.i)) for k in motions[a] if k != b]
    ways = [(k, b, [motions[k][a], motions[a][b]]) for k, a, b in thirds]
    return any(b in motions[k] and _same(motions[k][b], way) for k, b, way in ways) or any(
        b not in motions[k] and _holds(views, k, b, way, most) for k, b, way in ways
    )


def _same(found: F64, way: Sequence[F64]) -> bool:
    """Whether a motion is that of a way, but for drift."""
    off = invert_T(found) @ way[0] @ way[1]
    metres, degrees = drift(
        sum(float(np.linalg.norm(T[:3, 3])) for T in way), sum(float(angle_deg(T[:3, :3])) for T in way)
    )
    return bool(np.linalg.norm(off[:3, 3]) < metres and angle_deg(off[:3, :3]) < degrees)


def _holds(views: Sequence[View], k: int, b: int, way: Sequence[F64], most: float) -> bool:
    """Whether the surfaces of two frames stay where a way puts them, and leave free space free."""
    if _violation(views, k, b, way[0] @ way[1]) > most:
        return False
    edge = register_by_shape(views, k, b, [way[0] @ way[1]], FINE)
    return edge is not None and _same(edge.T_i_j, way)
