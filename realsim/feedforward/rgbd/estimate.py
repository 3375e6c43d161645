"""Poses from frames alone: pairs, pose graph, tracks, bundle adjustment. World = camera of the first frame used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realsim.errors import PoseError
from realsim.feedforward.rgbd.bundle import Adjusted, Observations, adjust
from realsim.feedforward.rgbd.graph import Edge, components, optimise, spanning_poses
from realsim.feedforward.rgbd.overlap import overlap
from realsim.feedforward.rgbd.pairs import ALL_PAIRS, MIN_AGREEMENT, by_features, by_shape, candidates, guided
from realsim.feedforward.rgbd.tracks import Match, Tracks, View, build_tracks
from realsim.geometry import invert_T
from realsim.progress import track
from realsim.types import F64

SIGMA_PX = 0.5
"""Localisation noise of features, pixels."""
SIGMA_INVERSE = 0.003
"""Noise of inverse depth, 1/m: 3 mm at 1 m, 12 mm at 2 m (range noise, quantisation and fixed pattern together)."""
EDGE_LIMIT = 6.0
"""Standard deviations beyond which a pair contradicts the graph and is left out."""
NEIGHBOURS = 8
"""After the first solution each frame is matched again with so many that share the most surface with it."""


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


def estimate(views: Sequence[View], seed: int) -> Estimate:
    """Poses of the largest set of views that can be connected.

    Raises:
        PoseError: fewer than two views hang together.
    """
    edges, matches = connect(views, seed)
    used, T, edges = _place(views, edges)
    lost = _lost(views, edges, used)
    local = {int(v): k for k, v in enumerate(used)}
    matches = [m for m in matches if m.i in local and m.j in local and _fits(m, T, local)]
    chosen = [views[i] for i in used]
    statistics: dict[str, Any] = {"pairs": len(edges)}
    if matches:
        first = [Match(local[m.i], local[m.j], m.a, m.b, m.T_i_j) for m in matches]
        T = bundle(chosen, T, first).T_world_camera
        T, more = bundle_again(chosen, T)
        statistics |= more
    return Estimate(tuple(int(i) for i in used), invert_T(T[0]) @ T, lost, statistics)


def connect(views: Sequence[View], seed: int) -> tuple[list[Edge], list[Match]]:
    """Every believable pair, by features first; by shape where features leave the sequence in pieces."""
    edges, matches = [], []
    for i, j in track(candidates(views, seed), "pairs"):
        found = by_features(views, i, j, seed)
        if found is not None:
            edges.append(found[0])
            matches.append(found[1])
    parts = components(len(views), edges)
    if len(parts) == 1:
        return edges, matches
    label = np.zeros(len(views), int)
    for k, part in enumerate(parts):
        label[part] = k
    reach = len(views) if len(views) <= ALL_PAIRS else 2
    loose = [(i, j) for i in range(len(views)) for j in range(i + 1, min(i + 1 + reach, len(views)))]
    for i, j in track([p for p in loose if label[p[0]] != label[p[1]]], "shapes"):
        edge = by_shape(views, i, j, seed)
        if edge is not None:
            edges.append(edge)
    return edges, matches


def _place(views: Sequence[View], edges: list[Edge]) -> tuple[np.ndarray, F64, list[Edge]]:
    """The largest connected part: its nodes, their poses, and the edges that do not contradict the rest."""
    while True:
        used = components(len(views), edges)[0]
        if len(used) < 2:
            raise PoseError(
                "the frames cannot be connected",
                expected="neighbouring frames that see the same surfaces, with texture or shape in common",
                found=f"no two of {len(views)} frames that fit together",
                hint="move the camera by less than a third of the picture between frames, or give poses",
            )
        local = {int(v): k for k, v in enumerate(used)}
        inner = [e for e in edges if e.i in local]
        here = [Edge(local[e.i], local[e.j], e.T_i_j, e.weight, e.root) for e in inner]
        T, chi = optimise(spanning_poses(len(used), here), here)
        wrong = chi > max(EDGE_LIMIT, 4 * float(np.median(chi)))
        if not wrong.any():
            return used, T, inner
        edges = [e for e, bad in zip(inner, wrong, strict=True) if not bad]


def _fits(m: Match, T: F64, local: dict[int, int]) -> bool:
    """Whether a pair's motion is the graph's, to within what a later adjustment can mend."""
    E = invert_T(m.T_i_j) @ invert_T(T[local[m.i]]) @ T[local[m.j]]
    return bool(np.linalg.norm(E[:3, 3]) < 0.15 and np.trace(E[:3, :3]) > 1 + 2 * np.cos(0.1))


def _lost(views: Sequence[View], edges: list[Edge], used: np.ndarray) -> dict[int, str]:
    out = {}
    for part in components(len(views), edges):
        for i in part:
            if i in used:
                continue
            with_ = [views[k].name for k in part if k != i]
            out[int(i)] = "does not fit to any frame that is used" + (
                f" (only to {', '.join(with_[:3])}{' ...' if len(with_) > 3 else ''})" if with_ else ""
            )
    return out


# ---------------------------------------------------------------- adjustment over all frames


def bundle(views: Sequence[View], T: F64, matches: Sequence[Match]) -> Adjusted:
    """Adjust poses and tracks twice, without the observations that the first time did not fit."""
    tracks = build_tracks(views, matches)
    seen, points = _observations(tracks, T)
    first = adjust(T, points, seen, iterations=8)
    bad = np.hypot(first.residual[:, 0], first.residual[:, 1]) > 5
    sigma = seen.sigma.copy()
    sigma[bad] = np.inf
    sigma[np.abs(first.residual[:, 2]) > 5, 2] = np.inf
    return adjust(first.T_world_camera, first.points, Observations(seen.camera, seen.point, seen.measured, sigma))


def bundle_again(views: Sequence[View], T: F64) -> tuple[F64, dict[str, Any]]:
    """Match all overlapping pairs anew under guidance of the poses, which closes loops, and adjust."""
    matches = [m for i, j in neighbours(views, T) if (m := guided(views, i, j, invert_T(T[i]) @ T[j])) is not None]
    if not matches:
        return T, {}
    result = bundle(views, T, matches)
    r = result.residual
    return result.T_world_camera, {
        "matched_pairs": len(matches),
        "tracks": len(result.points),
        "observations": len(r),
        "median_px": SIGMA_PX * float(np.median(np.hypot(r[:, 0], r[:, 1]))),
        "median_inverse_depth": SIGMA_INVERSE * float(np.median(np.abs(r[:, 2]))),
    }


def neighbours(views: Sequence[View], T: F64) -> list[tuple[int, int]]:
    """Pairs i < j that share surface at the given poses: for every view the NEIGHBOURS with the largest overlap.

    Near centres and like directions come first, so that the cost stays linear in the number of views.
    """
    from scipy.spatial import cKDTree

    place = np.concatenate([T[:, :3, 3] + 1.5 * T[:, :3, 2], 0.5 * T[:, :3, 3]], 1)
    _, near = cKDTree(place).query(place, k=min(len(views), 3 * NEIGHBOURS + 1))
    pairs = set()
    for i, row in enumerate(near):
        fits = [(overlap(views[i], views[j], invert_T(T[i]) @ T[j], 6), int(j)) for j in row if j != i]
        good = sorted(((-f.fraction, j) for f, j in fits if f.fraction > 0.1 and f.agreement > 0.5 * MIN_AGREEMENT))
        # Every other one of the ranking: the nearest views add little that the next do not.
        pairs |= {(min(i, j), max(i, j)) for _, j in [*good[:2], *good[2 : 2 * NEIGHBOURS : 2]]}
    return sorted(pairs)


def _observations(tracks: Tracks, T: F64) -> tuple[Observations, F64]:
    """Measurements with their noise, and the points where the depths put them on average."""
    own = np.column_stack([tracks.xy, np.ones(len(tracks.z))]) * tracks.z[:, None]
    world = np.einsum("mab,mb->ma", T[tracks.view, :3, :3], own) + T[tracks.view, :3, 3]
    count = np.maximum(np.bincount(tracks.point, minlength=tracks.count), 1)
    points = np.stack([np.bincount(tracks.point, world[:, k], tracks.count) / count for k in range(3)], 1)
    sigma_xy = SIGMA_PX / tracks.focal
    sigma = np.stack([sigma_xy, sigma_xy, np.full_like(sigma_xy, SIGMA_INVERSE)], 1)
    return Observations(tracks.view, tracks.point, np.column_stack([tracks.xy, 1 / tracks.z]), sigma), points
