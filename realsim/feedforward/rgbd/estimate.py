"""Poses from frames alone: pairs, pose graph, then the adjustment of refine.py. World = camera of the first frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from realsim.core.geometry import invert_T
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F64
from realsim.feedforward import matcher
from realsim.feedforward.rgbd.features import Match, View, build_tracks
from realsim.feedforward.rgbd.icp_links import link_by_shape
from realsim.feedforward.rgbd.keyframes import choose_by_matching
from realsim.feedforward.rgbd.learned import join_pieces, match_loops
from realsim.feedforward.rgbd.localize import Landmarks, localize
from realsim.feedforward.rgbd.loop_closure import Joined, join
from realsim.feedforward.rgbd.matching import (
    is_believable,
    make_edge,
    match_by_features,
    propose_pairs,
    register_by_shape,
)
from realsim.feedforward.rgbd.overlap import FINE
from realsim.feedforward.rgbd.pose_graph import Edge, optimise
from realsim.feedforward.rgbd.refine import adjust_to_features, match_and_adjust
from realsim.feedforward.rgbd.refine_pairs import choose_overlapping

WORTH_TELLING = 3
"""Frames from which a piece that is left out is named as one."""
SUSPICIOUS = 20
"""From this many features that match although the depth contradicts them, a dropped frame's reason mentions them."""
SHAPE_NEIGHBOURS = 5
"""Others that each frame is registered with by shape after the first solution: a pair costs ten times as much as by
features."""


@dataclass(frozen=True)
class Estimate:
    """Poses of the frames that hang together."""

    used: tuple[int, ...]
    """Indices of the N frames used, in order."""
    T_world_camera: F64
    """(N, 4, 4), metres by the sensor's own depth; the first is the identity."""
    lost: dict[int, str]
    """Index -> why it is not used."""
    statistics: dict[str, Any]
    warnings: tuple[str, ...] = ()
    links: tuple[Edge, ...] = ()
    """Pairs that were believed, indices of the views that were given."""


def estimate(views: Sequence[View], seed: int, learned: bool = True) -> Estimate:
    """Poses of the largest set of views that can be connected.

    Args:
        learned: ask the learned matcher where features leave the views in pieces.

    Raises:
        PoseError: fewer than two views hang together.
    """
    keys, followers = choose_by_matching(views, seed)
    found, landmarks = _estimate_together([views[k] for k in keys], seed, learned)
    matcher.release()
    T = {keys[i]: pose for i, pose in zip(found.used, found.T_world_camera, strict=True)}
    lost = {keys[i]: why for i, why in found.lost.items()}
    lost |= {k: lost[key] for k, (key, _) in followers.items() if key in lost}
    rest = [k for k in followers if k not in lost]
    if rest:
        starts = np.stack([T[followers[k][0]] @ followers[k][1] for k in rest])
        if landmarks is not None:
            starts, _ = localize([views[k] for k in rest], starts, landmarks)
        T |= dict(zip(rest, starts, strict=True))
    used = sorted(T)
    poses = np.stack([T[k] for k in used])
    poses = invert_T(poses[0]) @ poses
    poses[0] = np.eye(4)  # without what rounding left
    statistics = found.statistics | ({"keyframes": len(keys)} if followers else {})
    links = tuple(replace(e, i=keys[e.i], j=keys[e.j]) for e in found.links)
    return Estimate(tuple(used), poses, lost, statistics, found.warnings, links)


def _estimate_together(views: Sequence[View], seed: int, learned: bool) -> tuple[Estimate, Landmarks | None]:
    """All views in one adjustment, in the first one's camera; what it stands on, if these are features."""
    net = connect(views, seed, learned)
    views = net.views
    joined = join(views, net.edges)
    used, T, edges = joined.used, joined.T, joined.edges
    lost = _lost(views, net, joined)
    chosen = [views[i] for i in used]
    statistics: dict[str, Any] = {"pairs": len(edges), "refused_links": len(joined.refused)}
    statistics["parts"] = [len(p) for p in joined.parts if len(p) > 1]
    statistics |= net.counts
    local = {int(v): k for k, v in enumerate(used)}
    first = [Match(local[m.i], local[m.j], m.a, m.b, m.T_i_j) for m in net.matches if _fits(m, T, local)]
    landmarks = None
    if net.matches:
        if first:
            T = adjust_to_features(T, build_tracks(chosen, first), seed)[0].state.T
        kept = [m for m in first if (int(used[m.i]), int(used[m.j])) in net.learned]
        if kept:
            chosen, loops = match_loops(chosen, choose_overlapping(chosen, T), seed)
            kept += [m for m in loops if _fits(m, T, {k: k for k in range(len(chosen))})]
            T = adjust_to_features(T, build_tracks(chosen, first + kept), seed)[0].state.T
            statistics["learned_loops"] = len(loops)
        landmarks, more = match_and_adjust(chosen, T, kept, seed)
        if landmarks is not None:
            T = landmarks.T_world_camera
        statistics |= more
    else:
        here = [Edge(local[e.i], local[e.j], e.T_i_j, e.weight, e.root) for e in edges]
        T, closed = close_loops(chosen, T, here)
        statistics |= {"pairs": len(closed), "by_shape": True}
    notes = tuple(net.notes) + _warnings(views, joined)
    return Estimate(tuple(int(i) for i in used), T, lost, statistics, notes, tuple(joined.edges)), landmarks


@dataclass(frozen=True)
class Net:
    """Measurements of pairs of views."""

    edges: list[Edge]
    """Believed."""
    matches: list[Match]
    """Features behind the edges that have any."""
    doubts: dict[tuple[int, int], str]
    """Pairs whose features match but whose depth says otherwise."""
    views: list[View]
    """The views, some with more features than before."""
    learned: set[tuple[int, int]]
    """Pairs that the learned matcher matched."""
    notes: list[str]
    """Of the learned matcher, for people."""
    counts: dict[str, int]
    """The same in figures; empty where it was not asked."""


def connect(views: Sequence[View], seed: int, learned: bool = True) -> Net:
    """Every believable pair, by features; by learned ones and by shape where these leave the sequence in pieces."""
    net = Net([], [], {}, list(views), set(), [], {})
    pairs = propose_pairs(views, seed)
    matched_pairs = in_order(lambda k: match_by_features(views, *pairs[k], seed), len(pairs))
    for (i, j), found in zip(pairs, track(matched_pairs, "pairs", len(pairs)), strict=True):
        if found is None:
            continue
        matched, fit = found
        if is_believable(fit):
            net.edges.append(make_edge(matched))
            net.matches.append(matched)
        elif len(matched.a) >= SUSPICIOUS:
            net.doubts[i, j] = (
                f"{len(matched.a)} features match {{}}, but at that motion {1 - fit.agreement:.0%} of the depth is "
                "impossible: something was moved between the frames?"
            )
    if learned:  # pairs of the learned matcher, and the features that it found
        found_more = join_pieces(net.views, net.edges, seed)
        net.views[:] = found_more.views
        net.matches.extend(found_more.matches)
        net.edges.extend(map(make_edge, found_more.matches))
        net.learned.update((m.i, m.j) for m in found_more.matches)
        net.notes.extend(found_more.notes())
        if found_more.queried:
            net.counts.update(learned_queried=found_more.queried, learned_pairs=len(found_more.matches))
    # Pairs by shape that a third frame confirms.
    believed, refused = link_by_shape(net.views, net.edges, seed)
    net.edges.extend(believed)
    for e in refused:
        net.doubts.setdefault((e.i, e.j), "by shape alone it fits {}, which no third frame confirms")
    return net


def close_loops(views: Sequence[View], T: F64, edges: list[Edge]) -> tuple[F64, list[Edge]]:
    """Register all overlapping pairs by shape, starting from poses that are nearly right, and optimise; twice."""
    for _ in range(2):
        known = {(e.i, e.j): e for e in edges}
        for i, j in track(choose_overlapping(views, T, SHAPE_NEIGHBOURS), "loops"):
            edge = register_by_shape(views, i, j, [invert_T(T[i]) @ T[j]], FINE)
            if edge is not None and ((i, j) not in known or edge.weight >= known[i, j].weight):
                known[i, j] = edge
        edges = list(known.values())
        T, _ = optimise(T, edges)
    return T, edges


def _fits(m: Match, T: F64, local: dict[int, int]) -> bool:
    """Whether a pair is in the graph, with a motion that a later adjustment can mend."""
    if m.i not in local or m.j not in local:
        return False
    E = invert_T(m.T_i_j) @ invert_T(T[local[m.i]]) @ T[local[m.j]]
    return bool(np.linalg.norm(E[:3, 3]) < 0.15 and np.trace(E[:3, :3]) > 1 + 2 * np.cos(0.1))


def _lost(views: Sequence[View], net: Net, joined: Joined) -> dict[int, str]:
    """Index -> why, of the views that are not used."""
    out = {}
    for part in joined.parts[1:]:
        for i in map(int, part):
            others = [views[k].name for k in part if k != i]
            only = f" (only to {', '.join(others[:3])}{' ...' if len(others) > 3 else ''})" if others else ""
            doubt = next(
                (text.format(views[a + b - i].name) for (a, b), text in net.doubts.items() if i in (a, b)), None
            )
            out[i] = f"does not fit to any frame that is used{only}" + (f"; {doubt}" if doubt else "")
    return out


def _warnings(views: Sequence[View], joined: Joined) -> tuple[str, ...]:
    """Pieces that could not be joined, in words."""
    pieces = [p for p in joined.parts[1:] if len(p) >= WORTH_TELLING]
    if not pieces:
        return ()
    named = ", ".join(f"{views[p[0]].name} to {views[p[-1]].name} ({len(p)} frames)" for p in pieces[:4])
    return (
        f"the capture falls into {len(pieces) + 1} pieces that nothing joins for certain; the largest of "
        f"{len(joined.used)} frames is used, not {named}",
    )
