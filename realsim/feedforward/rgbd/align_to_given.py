"""Poses that were estimated although the capture has some: its metres and its gravity still count.

The trajectory that the depth gives and the one that came with the capture are laid on each other (Umeyama 1991). Where
most frames agree, the result is put into the capture's world, whose up is known, and the ratio of the two metres is the
depth sensor's gain.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.core.geometry import make_T, nearest_rotation
from realsim.core.types import F64, Frame, FrameSet
from realsim.feedforward.rgbd.accept_refinement import warn_of_scale

AGREE = (0.05, 0.02)
"""A frame agrees if its position differs by less than this many metres, or this share of the path's extent."""
MOST = 0.7
"""Share of frames that must agree."""


def align_to_given(found: dict[str, Any], used: Sequence[Frame], capture: FrameSet, correct: bool) -> dict[str, Any]:
    """The fields of a `Solution`, in the capture's world and metres where its own poses agree with what was found.

    Args:
        found: fields with poses (N, 4, 4) in metres by the depth.
        used: the N frames, with the capture's poses if it has any.
        correct: whether the depth's metres may be corrected.
    """
    given = [f.T_world_camera for f in used if f.T_world_camera is not None]
    if len(given) < len(used) or len(used) < 8 or not capture.poses_metric:
        return {**found, "world_is_capture": False}
    T, G = found["T_world_camera"], np.stack(given)
    S, scale, agree = _laid_on(T, G)
    share = float(agree.mean())
    sigma = _scale_sigma(T[agree], G[agree], S, scale) if agree.sum() >= 8 else np.inf
    statistics = {"share": share, "scale": scale, "scale_sigma": float(sigma)}
    out = {**found, "statistics": {**found["statistics"], "capture_poses": statistics}}
    limit = max(0.05, 3 * capture.sensor_sigma)
    if share < MOST or abs(scale - 1) > limit + 2 * sigma:
        text = (
            f"the capture's own poses are of no use: {share:.0%} of the frames agree with what was found, at "
            f"{scale:.3g} of its scale"
        )
        return {**out, "world_is_capture": False, "warnings": (*found["warnings"], text)}
    apply = correct and sigma < capture.sensor_sigma
    if not apply:
        S, scale, agree = _laid_on(T, G, rigid=True)
    placed = T.copy()
    placed[:, :3, 3] *= scale
    return {
        **out,
        "T_world_camera": make_T(S[:3, :3], S[:3, 3]) @ placed,
        "world_is_capture": True,
        "depth_gain": scale,
        "depth_gain_sigma": float(sigma) if apply else None,
        "warnings": (*found["warnings"], *warn_of_scale(scale)),
    }


def _laid_on(T: F64, G: F64, rigid: bool = False) -> tuple[F64, float, np.ndarray]:
    """(4, 4) rotation and place, the scale before them, and which frames (N,) agree; the others are left out."""
    a, b = T[:, :3, 3], G[:, :3, 3]
    keep = np.ones(len(a), bool)
    for _ in range(6):
        ca, cb = a[keep].mean(0), b[keep].mean(0)
        # Where the camera looks counts as well: places on a line leave the turn about it open.
        reach = max(float(np.sqrt(((a[keep] - ca) ** 2).sum(1).mean())), 0.1)
        looks = (
            np.concatenate([T[keep][:, :3, k] for k in range(3)]),
            np.concatenate([G[keep][:, :3, k] for k in range(3)]),
        )
        M = (b[keep] - cb).T @ (a[keep] - ca) + reach**2 / 3 * looks[1].T @ looks[0]
        R = nearest_rotation(M)
        turned = (a - ca) @ R.T
        scale = 1.0 if rigid else float((turned[keep] * (b[keep] - cb)).sum() / max((turned[keep] ** 2).sum(), 1e-12))
        off = np.linalg.norm(scale * turned + cb - b, axis=1)
        agree = off < max(AGREE[0], AGREE[1] * float(np.ptp(b, axis=0).max()))
        if agree.sum() < 4 or (agree == keep).all():
            break
        keep = agree
    return make_T(R, cb - scale * R @ ca), scale, agree


def _scale_sigma(T: F64, G: F64, S: F64, scale: float) -> float:
    """Relative standard error of the scale: jackknife over twelve blocks of frames, since both ways drift."""
    blocks = np.arange(len(T)) * min(12, len(T)) // len(T)
    scales = []
    for k in range(int(blocks.max()) + 1):
        rest = blocks != k
        a, b = T[rest, :3, 3], G[rest, :3, 3]
        a, b = (a - a.mean(0)) @ S[:3, :3].T, b - b.mean(0)
        scales.append(float((a * b).sum() / max((a**2).sum(), 1e-12)))
    n = len(scales)
    return float(np.sqrt((n - 1) / n * ((np.array(scales) - np.mean(scales)) ** 2).sum()) / scale)
