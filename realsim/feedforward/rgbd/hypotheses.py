"""What may be wrong with given poses as a whole: a name, how it is undone, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from realsim.core.geometry import invert_T, make_T
from realsim.core.types import F64

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
BODY = make_T(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""OpenCV camera axes written in x forward, y left, z up."""


@dataclass(frozen=True)
class Hypothesis:
    """One reading of poses that are not what they should be."""

    name: str
    undo: Callable[[F64], F64]
    """(N, 4, 4) poses as they are -> as they would be without it."""
    hint: str


def shift_poses(T: F64, shift: float) -> F64:
    """Poses `shift` frames later, interpolated; beyond the ends they stay."""
    n = len(T)
    at = np.clip(np.arange(n) + shift, 0, n - 1)
    out = np.tile(np.eye(4), (n, 1, 1))
    if n < 2:
        return T
    out[:, :3, :3] = Slerp(np.arange(n), Rotation.from_matrix(T[:, :3, :3]))(at).as_matrix()
    low = np.minimum(at.astype(int), n - 2)
    part = (at - low)[:, None]
    out[:, :3, 3] = (1 - part) * T[low, :3, 3] + part * T[low + 1, :3, 3]
    return out


def _scaled(T: F64, factor: float) -> F64:
    out = T.copy()
    out[:, :3, 3] *= factor
    return out


def _turned(degrees: float) -> F64:
    return make_T(Rotation.from_euler("z", degrees, degrees=True).as_matrix())


_PORTRAIT = "images or poses were rotated for portrait"
CONVENTIONS = (
    Hypothesis("OpenGL camera axes (y up, z backward)", lambda T: T @ FLIP, "turn y and z of the camera axes"),
    Hypothesis("world-to-camera matrices", invert_T, "invert the matrices"),
    Hypothesis("OpenGL world-to-camera matrices", lambda T: invert_T(T) @ FLIP, "invert the matrices and turn y and z"),
    Hypothesis("body axes (x forward, y left, z up)", lambda T: T @ BODY, "rotate to camera axes"),
    Hypothesis("a camera turned by 90 degrees", lambda T: T @ _turned(90), _PORTRAIT),
    Hypothesis("a camera turned by -90 degrees", lambda T: T @ _turned(-90), _PORTRAIT),
    Hypothesis("a camera turned by 180 degrees", lambda T: T @ _turned(180), "images or poses were rotated"),
    Hypothesis(
        "mirrored images, or poses of left-handed axes", lambda T: MIRROR @ T @ MIRROR, "mirror images or poses"
    ),
)
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
OFFSETS = (-4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4)
"""Frames."""


def of_poses(scale: float | None) -> list[Hypothesis]:
    """Conventions, units, and a time offset between poses and images; `scale`: metres by depth for one by the poses."""
    other = {} if scale is None else {f"poses of another scale ({1 / scale:.3g} units a metre)": scale}
    return [
        *CONVENTIONS,
        *(
            Hypothesis(
                name,
                partial(_scaled, factor=factor),
                f"multiply the positions by {factor:.4g}, or pass --no-metric-poses: the depth then scales them",
            )
            for name, factor in {**UNITS, **other}.items()
        ),
        *(
            Hypothesis(
                f"a time offset between poses and images of {-shift:g} frames",
                partial(shift_poses, shift=shift),
                "associate poses and images by their timestamps anew",
            )
            for shift in OFFSETS
        ),
    ]


def of_depth_images() -> list[Hypothesis]:
    """Depth images that are late or early: their poses are those of other frames."""
    return [
        Hypothesis(
            f"the depth images are {abs(shift)} frames {'late' if shift > 0 else 'early'}",
            partial(shift_poses, shift=-shift),
            "associate colour and depth by their time stamps anew",
        )
        for shift in range(-4, 5)
        if shift
    ]


def best_of(
    hypotheses: list[Hypothesis], T: F64, misplaced: Callable[[F64], float], limit: float
) -> tuple[Hypothesis, float] | None:
    """The hypothesis that leaves the least misplacement (metres), if that is below `limit`; of equals the first."""
    best: tuple[Hypothesis, float] | None = None
    for hypothesis in hypotheses:
        value = misplaced(hypothesis.undo(T))
        if value < limit and (best is None or value < 0.999 * best[1]):
            best = hypothesis, value
    return best
