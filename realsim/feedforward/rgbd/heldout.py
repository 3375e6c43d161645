"""Are refined poses better than what was given? Pairs of frames that took no part say so, depth against depth.

Depth was measured without the poses, so where two frames see one surface, right poses make their depths meet. A
refinement that follows wrong evidence (colour that is not registered to depth, say) pulls them apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from realsim.core.geometry import invert_T
from realsim.core.types import F64
from realsim.feedforward.rgbd.features import View
from realsim.feedforward.rgbd.refine_pairs import look_up, sample_surface

EVERY = 5
"""Of this many pairs that are not neighbours in the sequence, one is held out."""
REACH = 0.1
"""Metres at which a distance counts no further: what lies behind another surface is hidden, not wrong."""
POINTS = 300
"""Surface points a view."""

Pair = tuple[int, int]


def hold_out(pairs: Sequence[Pair]) -> tuple[list[Pair], list[Pair]]:
    """(pairs to use, pairs to ask afterwards); neighbours are always used, they keep the frames connected."""
    far = [p for p in pairs if p[1] - p[0] > 1]
    held = set(far[EVERY // 2 :: EVERY])
    return [p for p in pairs if p not in held], sorted(held)


@dataclass(frozen=True)
class Comparison:
    """Depth-on-depth distances of two solutions, on the same points of held-out pairs, metres of the sensor."""

    before_m: float
    after_m: float
    """Mean over pairs of the mean distance, those beyond `REACH` as `REACH`."""
    growth_sigma_m: float
    """Standard error of the mean over pairs of how much the distance grew."""
    pairs: int

    @property
    def grew(self) -> bool:
        """Whether the second is worse beyond what chance explains (two standard errors)."""
        return self.pairs > 0 and self.after_m - self.before_m > 2 * self.growth_sigma_m


def compare(
    views: Sequence[View], pairs: Sequence[Pair], before: tuple[F64, float], after: tuple[F64, float], seed: int = 0
) -> Comparison:
    """Two solutions, each (poses (N, 4, 4), depth gain), on pairs that neither was fitted to.

    Only points that both solutions find in the other frame are compared, so that neither gains by looking away.
    """
    rng = np.random.default_rng([seed, 17])
    samples = {i: sample_surface(views[i], rng, POINTS)[0] for i in sorted({i for i, _ in pairs})}
    rows = []
    for i, j in pairs:
        (d0, ok0), (d1, ok1) = (_distances(views[j], samples[i], T[i], T[j], gain) for T, gain in (before, after))
        both = ok0 & ok1
        if both.sum() >= 20:
            rows.append((d0[both].mean(), d1[both].mean()))
    if len(rows) < 2:
        return Comparison(float("nan"), float("nan"), float("nan"), 0)
    found = np.array(rows)
    growth = found[:, 1] - found[:, 0]
    before_m, after_m = map(float, found.mean(0))
    return Comparison(before_m, after_m, float(growth.std(ddof=1) / np.sqrt(len(growth))), len(rows))


def _distances(view: View, p: F64, T_i: F64, T_j: F64, gain: float) -> tuple[F64, np.ndarray]:
    """(M,) distances along the normal of points p of one frame from the surface that another sees, and which count."""
    if not len(p):
        return np.zeros(0), np.zeros(0, bool)
    D = invert_T(T_j) @ T_i
    y = p @ D[:3, :3].T + D[:3, 3] / gain
    q, n, ok = look_up(view, y)
    return np.minimum(np.abs(np.einsum("mk,mk->m", n, y - q)), REACH), ok
