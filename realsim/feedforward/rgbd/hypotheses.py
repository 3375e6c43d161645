"""What may be wrong with given poses as a whole: one table of names, how each is undone and tested, and what to do.

Rows are tried group by group; of the first group in which a row explains what was found, the best row is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from realsim.core.geometry import interpolated_T, invert_T, make_T
from realsim.core.types import F64
from realsim.feedforward.rgbd.depth_colour_sync import has_own_depth

if TYPE_CHECKING:
    from realsim.feedforward.rgbd.check_poses import Comparison

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
BODY = make_T(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""OpenCV camera axes written in x forward, y left, z up."""

Test = Callable[["Comparison", F64], float]
"""Frames, (N, 4, 4) poses -> metres by which they misplace what the frames see; infinite where that says nothing."""


@dataclass(frozen=True)
class Hypothesis:
    """One reading of poses that are not what they should be."""

    name: str
    undo: Callable[[F64], F64]
    """(N, 4, 4) poses as they are -> as they would be without it."""
    test: Test
    hint: str


Explanation = tuple[Hypothesis, float]
"""A hypothesis, and the misplacement that it leaves, metres."""


def explain(hypotheses: Sequence[Hypothesis], found: Comparison, limit: float) -> Explanation | None:
    """The hypothesis that leaves the least misplacement, if that is below `limit` metres; of equals the first."""
    best: Explanation | None = None
    for hypothesis in hypotheses:
        left = hypothesis.test(found, hypothesis.undo(found.T))
        if left < limit and (best is None or left < 0.999 * best[1]):
            best = hypothesis, left
    return best


# ---------------------------------------------------------------- tests


def by_points(found: Comparison, T: F64) -> float:
    """By the pairs of frames that surely see the same: those that share features, else those next to each other. A
    reading under which they no longer see each other explains nothing."""
    error = found.misplaced(found.certain, T)
    return float(np.nanmedian(error)) if np.isfinite(error).sum() >= max(0.7 * len(error), 1) else float("inf")


def by_depth(found: Comparison, T: F64) -> float:
    """By depth alone, of the pairs that features speak of."""
    error = found.misplaced(found.bare, T)
    return float(np.nanmedian(error)) if np.isfinite(error).sum() >= 4 else float("inf")


def by_depth_without_colour(found: Comparison, T: F64) -> float:
    """By depth alone, where features do not fit the depth of their own frames better than any other."""
    left = by_depth(found, T)
    return float("inf") if has_own_depth(found.evidence.views, found.seed) else left


# ---------------------------------------------------------------- the table


def shift_poses(T: F64, shift: float) -> F64:
    """Poses `shift` frames later, interpolated; beyond the ends they stay."""
    frame = np.arange(len(T), dtype=float)
    return T if len(T) < 2 else interpolated_T(frame, T, np.clip(frame + shift, 0, len(T) - 1))


def _scaled(T: F64, factor: float) -> F64:
    out = T.copy()
    out[:, :3, 3] *= factor
    return out


def _turned(T: F64, degrees: float) -> F64:
    return T @ make_T(Rotation.from_euler("z", degrees, degrees=True).as_matrix())


UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
OFFSETS = (-4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4)
"""Frames."""


def of_poses(scale: float | None) -> list[Hypothesis]:
    """Conventions, units, and a time offset between poses and images; `scale`: metres by depth for one by the poses."""
    rows: list[tuple[str, Callable[[F64], F64], str]] = [
        ("OpenGL camera axes (y up, z backward)", lambda T: T @ FLIP, "turn y and z of the camera axes"),
        ("world-to-camera matrices", invert_T, "invert the matrices"),
        ("OpenGL world-to-camera matrices", lambda T: invert_T(T) @ FLIP, "invert the matrices and turn y and z"),
        ("body axes (x forward, y left, z up)", lambda T: T @ BODY, "rotate to camera axes"),
    ]
    for degrees in (90, -90, 180):
        turned = partial(_turned, degrees=degrees)
        rows.append((f"a camera turned by {degrees} degrees", turned, "images or poses were rotated, as for portrait"))
    mirrored = "mirrored images, or poses of left-handed axes"
    rows.append((mirrored, lambda T: MIRROR @ T @ MIRROR, "mirror images or poses"))
    other = {} if scale is None else {f"poses of another scale ({1 / scale:.3g} units a metre)": scale}
    for name, factor in {**UNITS, **other}.items():
        hint = f"multiply the positions by {factor:.4g}, or pass --no-metric-poses: the depth then scales them"
        if name in other:
            hint = f"check the focal length first, which looks the same where it is wrong; if it is right, {hint}"
        rows.append((name, partial(_scaled, factor=factor), hint))
    for shift in OFFSETS:
        offset = f"a time offset between poses and images of {-shift:g} frames"
        rows.append((offset, partial(shift_poses, shift=shift), "associate poses and images by their timestamps anew"))
    return [Hypothesis(name, undo, by_points, hint) for name, undo, hint in rows]


OTHER_COLOUR = [
    Hypothesis(
        "the colour images belong to other depth images than those they are named with",
        lambda T: T,
        by_depth_without_colour,
        "check that colour and depth come from one capture and carry the same numbers or times",
    )
]
