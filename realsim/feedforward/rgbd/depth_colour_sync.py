"""Do colour and depth show the same view at the same time? Features with their depth have to move like a rigid thing.

Which features of two frames are alike depends on colour alone. With the depth that belongs to them they are points that
one rigid motion explains; with depth of another moment, or of the mirror image, most are not. So no poses are needed to
tell, and the same test under other readings (depth some frames earlier or later, images flipped) names what is wrong.
A capture of which everything is mirrored is a capture of the mirrored place: nothing in it says otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import PoseError
from realsim.core.types import F64
from realsim.feedforward.rgbd.extrinsic_calibration import look_up_inverse_depth
from realsim.feedforward.rgbd.features import View, match_descriptors, rigid_ransac

Index = NDArray[np.int64]

LATE = 4
"""Frames by which depth may be late or early: each is a look at every pair. Budget."""
STEPS, PAIRS = (1, 3), 12
"""Frames from one of a pair to the other (near ones have most in common, far ones move more), and how many of each
are asked. Budget."""
CLEAR = 3.0
"""Standard errors over pairs of frames by which another reading has to fit better. Set on four captures (two rendered,
an iPhone, a RealSense): right ones lie 3.5 to 15 on the other side, spoilt ones 3.0 to 21 beyond, and ten far frames
with depth three late 1.8. On five rendered ones that it was not set on, two of an unregistered colour, right ones
lie 8 to 16 on the other side, and all fifteen that were spoilt 3.7 to 22 beyond, each with its right name."""
LEAST = 30
"""Features that are alike which a pair needs to be asked: some that move rigidly by chance do not count then. Not
tuned."""


@dataclass(frozen=True)
class Reading:
    """How depth is found for a feature of the colour image."""

    late: int = 0
    """Frames by which depth comes after the colour that it belongs to."""
    flip: tuple[int, int] = (1, 1)
    """-1 where colour runs the other way than depth, across and down."""

    @property
    def name(self) -> str:
        """In words, as something that is wrong."""
        if self.late:
            count = f"{abs(self.late)} frame{'s' if abs(self.late) > 1 else ''}"
            return f"the depth images are {count} {'late' if self.late > 0 else 'early'}"
        how = {(-1, 1): "mirrored left to right", (1, -1): "mirrored top to bottom", (-1, -1): "turned by 180 degrees"}
        return f"the depth images are {how[self.flip]} against the colour images, or these against them"

    @property
    def hint(self) -> str:
        """What to do about it."""
        if self.late:
            return "associate colour and depth by their time stamps anew"
        return "store both as the sensor sees them"


OTHERS = (
    *(Reading(late) for late in range(-LATE, LATE + 1) if late),
    *(Reading(flip=flip) for flip in ((-1, 1), (1, -1), (-1, -1))),
)


def check_together(views: Sequence[View], source: Path | None, seed: int = 0) -> None:
    """Refuse colour and depth of which another reading fits clearly better; `source` is named in the error.

    Raises:
        PoseError: depth of another time, or colour and depth that are flipped against each other.
    """
    found = measure_shares(views, seed)
    if found is None:
        return
    read = found.pop(Reading())
    best = max(found, key=lambda r: found[r].mean())
    if not _clear(found[best] - read):
        return
    raise PoseError(
        best.name,
        file=source,
        expected="colour and depth of one view at one time in each frame",
        found=f"of the features that look alike in {len(read)} pairs of frames {read.mean():.0%} move like a rigid "
        f"thing with the depth as it is, {found[best].mean():.0%} with that undone",
        hint=best.hint,
    )


def has_own_depth(views: Sequence[View], seed: int = 0) -> bool:
    """Whether features fit the depth of their own frame clearly better than that of any other reading: colour of
    another capture does not."""
    found = measure_shares(views, seed)
    if found is None:
        return False
    read = found.pop(Reading())
    return all(_clear(read - other) for other in found.values())


def _clear(gain: F64) -> bool:
    return bool(gain.mean() > CLEAR * gain.std(ddof=1) / np.sqrt(len(gain)))


def measure_shares(views: Sequence[View], seed: int) -> dict[Reading, F64] | None:
    """Reading -> (M,) share of the features that are alike in each of M pairs of near frames which one rigid motion
    explains; None where too few are alike to tell."""
    n = len(views)
    inside = range(LATE, n - LATE) if n > 4 * LATE else range(n)
    firsts = []
    for step in STEPS:
        if len(inside) > step:
            some = np.unique(np.linspace(0, len(inside) - step - 1, PAIRS).astype(int))
            firsts += [(inside[k], step) for k in some]
    found = [(i, i + step, *match_descriptors(views[i], views[i + step])) for i, step in firsts]
    found = [m for m in found if len(m[2]) >= LEAST]
    if len(found) < PAIRS // 2:
        return None
    return {r: np.array([_rigid(views, *m, r, seed) for m in found]) for r in (Reading(), *OTHERS)}


def _rigid(views: Sequence[View], i: int, j: int, a: Index, b: Index, reading: Reading, seed: int) -> float:
    """Share of features that are alike which move rigidly, under a reading."""
    P, Q = _points(views, i, a, reading), _points(views, j, b, reading)
    known = np.isfinite(P).all(1) & np.isfinite(Q).all(1)
    if known.sum() < LEAST // 2:
        return 0.0
    motion = rigid_ransac(P[known], Q[known], np.random.default_rng((seed, i, j)))
    return 0.0 if motion is None else float(motion[1].sum() / len(a))


def _points(views: Sequence[View], i: int, features: Index, reading: Reading) -> F64:
    """(M, 3) features of a frame by the depth that a reading gives them, NaN where that is unknown."""
    view, source = views[i], views[min(max(i + reading.late, 0), len(views) - 1)]
    xy = view.xy[features]
    c = source.camera
    # Mirrored about the middle of the image, which need not be the principal point.
    middle = np.array([((c.width - 1) / 2 - c.cx) / c.fx, ((c.height - 1) / 2 - c.cy) / c.fy])
    at = middle + np.asarray(reading.flip) * (xy - middle)
    return np.column_stack([xy, np.ones(len(xy))]) / look_up_inverse_depth(source, at)[:, None]
