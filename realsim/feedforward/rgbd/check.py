"""Do given poses and measured depth describe one world?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from realsim.errors import PoseError
from realsim.feedforward.rgbd.overlap import overlap
from realsim.feedforward.rgbd.tracks import View
from realsim.geometry import invert_T
from realsim.types import F64

AGREES = 0.7
"""Agreement of two depth images below which their poses contradict each other."""
SHARES = 0.05
"""Share of a view that must lie on another's surface for the two to count as connected."""
SEQUENCE, SPACE = 3, 5
"""Each frame is compared with so many that follow it, and with so many that are nearest in space."""


def check_poses(views: Sequence[View], T_world_camera: F64, source: Path | None = None) -> dict[int, str]:
    """Index -> reason, of frames whose given pose their neighbours' depth contradicts.

    The frame with the largest share of contradicted neighbours goes first, and is then no witness against others.

    Raises:
        PoseError: fewer than half of the frames remain: then the poses are wrong as a whole, not single ones.
    """
    if len(views) < 2:
        return {}
    fits = {
        (i, j): overlap(views[i], views[j], invert_T(T_world_camera[i]) @ T_world_camera[j], 3)
        for i, j in _pairs(T_world_camera)
    }
    # A pair bears witness if the images lie on each other, or collide.
    witness = {p: f.agreement < AGREES for p, f in fits.items() if f.fraction > SHARES or f.agreement < AGREES}
    reasons: dict[int, str] = {}
    while True:
        share = {}
        for k in range(len(views)):
            said = [bad for p, bad in witness.items() if k in p]
            if said and np.mean(said) > 0.5:
                share[k] = (float(np.mean(said)), sum(said), k)
        if not share:
            break
        worst = max(share, key=share.__getitem__)
        reasons[worst] = f"its pose contradicts the depth of {share[worst][1]} of its neighbours"
        witness = {p: bad for p, bad in witness.items() if worst not in p}
    met = {k for p in witness for k in p}
    if met:
        for k in set(range(len(views))) - met - set(reasons):
            reasons[k] = "at its pose it shares no surface with any other frame"
    if 2 * len(reasons) > len(views):
        raise PoseError(
            "the given poses contradict the depth",
            file=source,
            expected="poses that bring the depth images onto each other (camera to world, OpenCV axes, metres)",
            found=f"{len(reasons)} of {len(views)} frames do not fit their neighbours",
            hint="check the pose convention and unit, or use --points.poses estimate",
        )
    return reasons


def _pairs(T: F64) -> list[tuple[int, int]]:
    """Pairs i < j next to each other in the sequence or in space."""
    from scipy.spatial import cKDTree

    n = len(T)
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(i + 1 + SEQUENCE, n))}
    # Where a camera is and what it looks at, about 1.5 m ahead.
    place = np.concatenate([T[:, :3, 3], T[:, :3, 3] + 1.5 * T[:, :3, 2]], 1)
    near = cKDTree(place).query(place, k=min(SPACE + 1, n))[1].reshape(n, -1)
    return sorted(pairs | {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(near) for j in row if j != i})
