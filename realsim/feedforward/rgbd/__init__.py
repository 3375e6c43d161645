"""Poses and points from sensor depth: given poses are checked and refined, absent ones are estimated."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.errors import PoseError
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig
from realsim.types import F64, Dropped, Frame, FrameSet, Pointmaps, Solution


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses in metres by the sensor's depth, in the capture's world if poses are given, else in the first camera's.

    Frames that do not fit are left out and named. With metric poses given, the depth sensor's gain comes with it.

    Raises:
        PoseError: see `realsim.feedforward.solve`.
    """
    given = _posed(frames, config)
    return _estimated(frames, config) if given is None else _given(frames, given, config)


def pointmaps(frames: FrameSet, solution: Solution, config: PointsConfig) -> Pointmaps:
    """Views from corrected sensor depth (`solution.depth_gain` times what the sensor said), camera frame, metres."""
    from realsim.feedforward.rgbd.views import point_view

    used = tuple(frames.frames[i] for i in solution.used)
    return Pointmaps(
        frames=used,
        T_world_camera=solution.T_world_camera,
        load=lambda i: point_view(used[i], solution.depth_gain),
        backend="rgbd",
        world_is_capture=solution.world_is_capture,
        metric_claim=solution.metric_claim,
        depth_gain=solution.depth_gain,
        depth_gain_sigma=solution.depth_gain_sigma,
        pose_sigma_m=solution.pose_sigma_m,
        dropped=solution.dropped,
        warnings=solution.warnings,
        statistics=solution.statistics,
    )


def _posed(frames: FrameSet, config: PointsConfig) -> list[int] | None:
    """Indices of the frames whose given poses are to be used, or None if poses are to be estimated."""
    if config.poses == "estimate":
        return None
    posed = [i for i, f in enumerate(frames.frames) if f.T_world_camera is not None]
    if config.poses == "given" and not posed:
        raise PoseError(
            "no poses in the capture", file=frames.source, hint="use --points.poses estimate to have them estimated"
        )
    return posed if config.poses == "given" or 2 * len(posed) > len(frames) else None


def _given(frames: FrameSet, posed: list[int], config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.check import check_poses
    from realsim.feedforward.rgbd.tracks import prepare

    chosen = [frames.frames[i] for i in posed]
    T = np.stack([_pose(f) for f in chosen])
    views = prepare(chosen)
    reasons = check_poses(views, T, frames.source)
    dropped = [Dropped(f.name, "has no pose") for f in frames.frames if f.T_world_camera is None]
    dropped += [Dropped(chosen[k].name, why) for k, why in sorted(reasons.items())]
    keep = [k for k in range(len(chosen)) if k not in reasons]
    chosen, views, T = [chosen[k] for k in keep], [views[k] for k in keep], T[keep]
    found: dict[str, Any] = {"T_world_camera": T, "statistics": {"poses": "given"}}
    if config.refine:
        gain = config.correct_depth_bias and frames.poses_metric
        found = _refined(chosen, T, estimate_gain=gain, trust="metric", seed=config.seed, views=views)
        found["statistics"]["poses"] = "given, refined"
    return Solution(used=tuple(posed[k] for k in keep), world_is_capture=True, dropped=tuple(dropped), **found)


def _estimated(frames: FrameSet, config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.estimate import estimate
    from realsim.feedforward.rgbd.tracks import prepare

    if len(frames) == 1:
        return Solution((0,), np.eye(4)[None], world_is_capture=False, statistics={"poses": "one frame"})
    views = prepare(frames.frames)
    result = estimate(views, config.seed)
    dropped = tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(result.lost.items()))
    return Solution(
        used=result.used,
        T_world_camera=result.T_world_camera,
        world_is_capture=False,
        dropped=dropped,
        statistics={"poses": "estimated", **result.statistics},
    )


def _refined(frames: list[Frame], T: F64, **options: Any) -> dict[str, Any]:
    """Fields of a `Solution` from a refinement against the depth."""
    from realsim.feedforward.rgbd.refine import refine

    result = refine(frames, T, **options)
    return {
        "T_world_camera": result.T_world_camera,
        "depth_gain": result.depth_gain,
        "depth_gain_sigma": result.depth_gain_sigma,
        "pose_sigma_m": result.residual_m,
        "warnings": tuple(result.warnings),
        "statistics": {
            **result.statistics,
            "residual_m": {f.name: float(r) for f, r in zip(frames, result.per_frame_residual_m, strict=True)},
        },
    }


def _pose(frame: Frame) -> F64:
    assert frame.T_world_camera is not None
    return frame.T_world_camera


BACKEND = Backend(solve, pointmaps)
