"""Pairs of frames that classical features cannot join are shown to a learned matcher (`realsim.feedforward.matcher`).

It is asked only where features leave the frames in pieces, and only about frames of different pieces: near ones first,
farther ones where the pieces still stand apart. What it proposes is judged as everything else is: one rigid motion must
explain the matched points, and the two depth images must agree at that motion. A capture that features hold together
is not touched.

Its keypoints become features of the views, without a classical descriptor: nothing is matched to them later. They are
localised to a pixel and a half instead of a third of one, and count accordingly.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realsim.core.progress import track
from realsim.feedforward import matcher
from realsim.feedforward.rgbd.features import Match, View, points_of, rigid_ransac
from realsim.feedforward.rgbd.matching import ALL_PAIRS, WINDOW, is_believable, make_edge, tighten
from realsim.feedforward.rgbd.overlap import overlap
from realsim.feedforward.rgbd.pose_graph import Edge, label_pieces

MOST = 1024
"""Keypoints with depth that take part; the cost of a pair grows with their square."""
NEAR = 2
"""Frames this many steps apart are asked even if the pieces are joined by now: one link cannot be checked."""
NOISE = 4.0
"""Localisation noise of its keypoints over that of SIFT. Set on the rendered stake_a: reprojection errors by the true
poses have a median of 1.6 pixels against 0.5 (neighbours), 1.9 against 0.9 (three frames apart)."""
TRIALS = 1000
"""Samples of three matches: of the proposed ones a third may be right."""
LEAST = 24
"""Matches that one motion must explain; twice as many as of SIFT, because four times as many are proposed."""


@dataclass(frozen=True)
class Learned:
    """What the learned matcher added."""

    views: list[View]
    """All views; those in `matches` have more features than before, the old ones first."""
    matches: list[Match]
    queried: int = 0
    """Pairs."""
    unavailable: str | None = None
    """Why it could not be asked although it would have been."""

    def notes(self) -> list[str]:
        """For people; nothing where it changed nothing."""
        if self.unavailable is not None:
            return [f"frames that features do not connect were not shown to the learned matcher: {self.unavailable}"]
        if not self.matches:
            return []
        names = [self.views[k].name for k in sorted({k for m in self.matches for k in (m.i, m.j)})]
        few = ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
        return [
            f"features found too little in some pairs of frames; a learned matcher joined {len(self.matches)} of the "
            f"{self.queried} that it was shown ({few}), and the depth agrees"
        ]


def join_pieces(views: Sequence[View], edges: Sequence[Edge], seed: int) -> Learned:
    """Ask about near pairs of frames that `edges` leave in different pieces."""
    n = len(views)
    piece = label_pieces(n, edges)
    reach = n if n <= ALL_PAIRS else WINDOW + 1
    seeing = [k for k in range(n) if _seen(views[k])]
    pairs = [(i, j) for i in seeing for j in seeing if i < j < i + reach and piece[i] != piece[j]]
    if not pairs:
        return Learned(list(views), [])
    why = matcher.missing()
    if why is not None:
        return Learned(list(views), [], unavailable=why)
    shown, keypoints = list(views), dict[int, matcher.Keypoints]()
    matches: list[Match] = []
    queried = 0
    for i, j in track(sorted(pairs, key=lambda p: (p[1] - p[0], p)), "hard matches"):
        if j - i > NEAR:
            now = label_pieces(n, [*edges, *map(make_edge, matches)])
            if now[i] == now[j]:
                continue
        queried += 1
        found = _match(views, shown, keypoints, i, j, seed)
        if found is not None:
            matches.append(found)
    return Learned(*_trimmed(views, shown, keep_supported(matches, n, edges)), queried)


def match_loops(views: Sequence[View], pairs: Sequence[tuple[int, int]], seed: int) -> tuple[list[View], list[Match]]:
    """Matches of pairs that overlap but are far apart in the sequence, at most one for each view, and the views with
    the features that they are of. Chains drift, and matching under guidance follows the drift; this does not."""
    far = [(i, j) for i, j in pairs if j - i > WINDOW and _seen(views[i]) and _seen(views[j])]
    far = [far[k] for k in np.unique(np.linspace(0, len(far) - 1, len(views)).astype(int))] if far else []
    shown, keypoints = list(views), dict[int, matcher.Keypoints]()
    found = [_match(views, shown, keypoints, i, j, seed) for i, j in track(far, "loops")]
    return _trimmed(views, shown, [m for m in found if m is not None])


def keep_supported(matches: Sequence[Match], n: int, edges: Sequence[Edge]) -> list[Match]:
    """Matches of n frames that do not join two pieces of `edges` alone: where frames are missing, the next place may
    only look like this one.

    Pieces of several frames have to say it twice, by different frames on both sides; one frame cannot. What is joined
    is one piece from then on: what its parts say of a third counts together.
    """
    out: list[Match] = []
    left = list(matches)
    while True:
        piece = label_pieces(n, [*edges, *map(make_edge, out)])
        groups = defaultdict(list)
        for m in left:
            groups[min(piece[m.i], piece[m.j]), max(piece[m.i], piece[m.j])].append(m)
        left = []
        for (a, b), group in groups.items():
            support = min(len({k for m in group for k in (m.i, m.j) if piece[k] == p}) for p in (a, b))
            good = a == b or support >= min(2, int((piece == a).sum()), int((piece == b).sum()))
            (out if good else left).extend(group)
        if len(left) == sum(map(len, groups.values())):
            return sorted(out, key=lambda m: (m.i, m.j))


def _seen(view: View) -> bool:
    return view.has_color and view.frame is not None


def _look(view: View) -> tuple[View, matcher.Keypoints]:
    """The view with the keypoints that have depth after its own features, and these keypoints."""
    assert view.frame is not None
    color = view.frame.color()
    assert color is not None
    found = matcher.extract(color)
    xy, z = points_of(view.frame, found.uv)
    keep = np.flatnonzero(z > 0)[:MOST]
    return view.extended(xy[keep], z[keep], NOISE), found.subset(keep)


def _match(
    views: Sequence[View], shown: list[View], keypoints: dict[int, matcher.Keypoints], i: int, j: int, seed: int
) -> Match | None:
    """What the matcher says of a pair, if one motion explains enough of it and the depth images agree.

    `shown`, the views with their keypoints, and `keypoints` are filled view by view.
    """
    for k in {i, j} - keypoints.keys():
        shown[k], keypoints[k] = _look(views[k])
    a, b = keypoints[i], keypoints[j]
    proposed = matcher.match(a, b)
    if len(proposed) < LEAST:
        return None
    proposed += np.array([len(shown[i].z) - len(a.uv), len(shown[j].z) - len(b.uv)])  # they are a view's last features
    P, Q = shown[i].points[proposed[:, 0]], shown[j].points[proposed[:, 1]]
    motion = rigid_ransac(P, Q, np.random.default_rng((seed, i, j)), TRIALS)
    if motion is None:
        return None
    T, inlier = motion
    first, second = proposed[inlier].T
    # Its points are rough and often close together: surfaces hold the far end of the picture.
    match = tighten(shown, Match(i, j, first, second, T))
    good = match is not None and len(match.a) >= LEAST and is_believable(overlap(shown[i], shown[j], match.T_i_j))
    return match if good else None


def _trimmed(views: Sequence[View], shown: Sequence[View], matches: Sequence[Match]) -> tuple[list[View], list[Match]]:
    """Views with those keypoints only that take part in a match, and the matches renumbered."""
    out, number = list(views), {}
    for k in {k for m in matches for k in (m.i, m.j)}:
        own = len(views[k].z)
        used = np.unique(np.concatenate([m.a if m.i == k else m.b for m in matches if k in (m.i, m.j)]))
        number[k] = np.full(len(shown[k].z), -1)
        number[k][used] = own + np.arange(len(used))
        out[k] = views[k].extended(shown[k].xy[used], shown[k].z[used], NOISE)
    return out, [replace(m, a=number[m.i][m.a], b=number[m.j][m.b]) for m in matches]
