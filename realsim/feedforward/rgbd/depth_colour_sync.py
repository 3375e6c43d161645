"""Do colour and depth show the same view at the same time? Features with their depth have to move like a rigid thing.

Which features of two frames are alike depends on colour alone. With the depth that belongs to them they are points that
one rigid motion explains; with depth of another moment, or of the mirror image, most are not. So no poses are needed to
tell, and the same test under other readings (depth some frames earlier or later, images flipped) names what is wrong.
A capture of which everything is mirrored is a capture of the mirrored place: nothing in it says otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import PoseError
from realsim.core.ordered import in_order
from realsim.core.types import F64
from realsim.feedforward.rgbd.extrinsic_calibration import Grids
from realsim.feedforward.rgbd.features import View, match_descriptors, rigid_ransac

Index = NDArray[np.int64]

LATE = 4
"""Frames by which depth may be late or early: each is a look at every pair. Budget."""
STEPS, PAIRS = (1, 3), 12
"""Frames from one of a pair to the other (near ones have most in common, far ones move more), and how many of each
are asked. Budget."""
CLEAR = 3.0
"""Standard errors over pairs of frames by which another reading has to fit better. Depth 1 to 4 frames late or early:
on 25 rendered captures of 12 to 80 frames the right reading is best in 125 of 125, and lies 6.3 beyond or more; sound
ones lie 6.2 to 18 on the other side. Of an iPhone's 4.8 and 5.0; of ten frames of a RealSense that hardly overlap, 1.6
to 8.7 and 1.4: two of five pass there."""
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
    best = max(found, key=lambda r: np.nanmean(found[r] - read), default=None)
    if best is None or not _clear(found[best] - read):
        return
    both = np.isfinite(found[best])
    raise PoseError(
        best.name,
        file=source,
        expected="colour and depth of one view at one time in each frame",
        found=f"of the features that look alike in {both.sum()} pairs of frames {read[both].mean():.0%} move like a "
        f"rigid thing with the depth as it is, {found[best][both].mean():.0%} with that undone",
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
    gain = gain[np.isfinite(gain)]
    return bool(gain.mean() > CLEAR * gain.std(ddof=1) / np.sqrt(len(gain)))


def measure_shares(views: Sequence[View], seed: int) -> dict[Reading, F64] | None:
    """Reading -> (M,) share of the features that are alike in each of M pairs of near frames which one rigid motion
    explains, NaN where the capture has no frame with the depth of that reading; without readings of which half of the
    pairs say nothing. None where too few are alike to tell."""
    n, firsts = len(views), []
    for step in STEPS:
        firsts += [(i, step) for i in np.unique(np.linspace(0, n - step - 1, PAIRS).astype(int)) if n > step]
    alike = in_order(lambda k: match_descriptors(views[firsts[k][0]], views[sum(firsts[k])]), len(firsts))
    found = [(i, i + step, *m) for (i, step), m in zip(firsts, alike, strict=True) if len(m[0]) >= LEAST]
    if len(found) < PAIRS // 2:
        return None
    readings = (Reading(), *OTHERS)
    each = in_order(lambda k: [_rigid(views, *found[k], r, seed) for r in readings], len(found))
    shares = dict(zip(readings, np.array(list(each)).T, strict=True))
    return {r: share for r, share in shares.items() if 2 * np.isfinite(share).sum() >= len(found)}


def _rigid(views: Sequence[View], i: int, j: int, a: Index, b: Index, reading: Reading, seed: int) -> float:
    """Share of features that are alike which move rigidly, under a reading; NaN beyond the ends of the capture."""
    if not 0 <= i + reading.late <= j + reading.late < len(views):
        return float("nan")
    P, Q = _points(views, i, a, reading), _points(views, j, b, reading)
    known = np.isfinite(P).all(1) & np.isfinite(Q).all(1)
    if known.sum() < LEAST // 2:
        return 0.0
    motion = rigid_ransac(P[known], Q[known], np.random.default_rng((seed, i, j)))
    return 0.0 if motion is None else float(motion[1].sum() / len(a))


def _points(views: Sequence[View], i: int, features: Index, reading: Reading) -> F64:
    """(M, 3) features of a frame by the depth that a reading gives them, NaN where that is unknown."""
    view, source = views[i], views[i + reading.late]
    xy = view.xy[features]
    c = source.camera
    # Mirrored about the middle of the image, which need not be the principal point.
    middle = np.array([((c.width - 1) / 2 - c.cx) / c.fx, ((c.height - 1) / 2 - c.cy) / c.fy])
    at = middle + np.asarray(reading.flip) * (xy - middle)
    return np.column_stack([xy, np.ones(len(xy))]) / Grids.of([source]).inverse_depth(0, at)[:, None]
