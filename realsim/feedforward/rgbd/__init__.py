"""Poses and points from sensor depth: given poses are checked and refined, absent ones are estimated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from realsim.errors import PoseError
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig
from realsim.types import F64, Dropped, Frame, FrameSet, Pointmaps, Solution

if TYPE_CHECKING:
    from realsim.feedforward.rgbd.tracks import Evidence


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
            "no poses in the capture", file=frames.source, hint="use --poses estimate to have them estimated"
        )
    return posed if config.poses == "given" or 2 * len(posed) > len(frames) else None


def _given(frames: FrameSet, posed: list[int], config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.refine_check import check_poses, scale_by_depth
    from realsim.feedforward.rgbd.tracks import Evidence

    chosen = [frames.frames[i] for i in posed]
    T = np.stack([f.T_world_camera for f in chosen if f.T_world_camera is not None])
    evidence = Evidence.of(chosen, config.seed)
    scaled: tuple[str, ...] = ()
    if not frames.poses_metric:
        factor, error = scale_by_depth(evidence, T)
        T[:, :3, 3] *= factor
        scaled = (
            f"the given poses are not in metres: their positions, and with them their world, were multiplied by "
            f"{factor:.4g} (± {error:.1%}), as the depth says",
        )
    check = check_poses(chosen, T, evidence=evidence, seed=config.seed)
    keep = check.kept(chosen)
    found: dict[str, Any] = {"T_world_camera": T[keep], "statistics": {"poses": "given"}, "warnings": ()}
    if config.refine:
        gain = config.correct_depth_bias and frames.poses_metric
        options = {"estimate_gain": gain, "trust": "metric", "seed": config.seed}
        found = _refined([chosen[k] for k in keep], T[keep], evidence.subset(keep), **options)
        found["statistics"]["poses"] = "given, refined"
    found["statistics"]["check"] = dict(check.statistics)
    found["warnings"] = scaled + check.warnings + found["warnings"]
    unposed = tuple(Dropped(f.name, "has no pose") for f in frames.frames if f.T_world_camera is None)
    return Solution(
        used=tuple(posed[k] for k in keep), world_is_capture=True, dropped=unposed + check.contradicting, **found
    )


def _estimated(frames: FrameSet, config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.estimate import estimate
    from realsim.feedforward.rgbd.tracks import Evidence

    if len(frames) == 1:
        return Solution((0,), np.eye(4)[None], world_is_capture=False, statistics={"poses": "one frame"})
    evidence = Evidence.of(frames.frames, config.seed)
    result = estimate(evidence.views, config.seed)
    found: dict[str, Any] = {"T_world_camera": result.T_world_camera, "statistics": {}}
    if result.statistics.get("by_shape"):  # without features nothing has looked at all views at once yet
        found = _refined(
            [frames.frames[i] for i in result.used],
            result.T_world_camera,
            evidence.subset(result.used),
            estimate_gain=False,
            trust="estimated",
            seed=config.seed,
        )
    found["statistics"] = {**found["statistics"], "poses": "estimated", **result.statistics}
    dropped = tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(result.lost.items()))
    return Solution(used=result.used, world_is_capture=False, dropped=dropped, **found)


def _refined(frames: list[Frame], T: F64, evidence: Evidence, **options: Any) -> dict[str, Any]:
    """Fields of a `Solution` from a refinement against the depth. Of a dense capture keyframes are refined together."""
    from realsim.feedforward.rgbd.follow import follow
    from realsim.feedforward.rgbd.keyframes import by_poses
    from realsim.feedforward.rgbd.refine import refine

    keys, followers = by_poses(evidence.views, T)
    result = refine([frames[k] for k in keys], T[keys], evidence=evidence.subset(keys), **options)
    poses, residual = T.copy(), np.full(len(T), np.nan)
    poses[keys], residual[keys] = result.T_world_camera, result.per_frame_residual_m
    statistics = dict(result.statistics)
    if followers:
        rest = list(followers)
        starts = np.stack([poses[key] @ motion for key, motion in followers.values()])
        position, degrees = statistics.get("given_position_sigma_m"), statistics.get("given_angle_sigma_deg")
        prior = None if position is None or degrees is None else (float(position), float(np.radians(degrees)))
        poses[rest], residual[rest] = follow([evidence.views[k] for k in rest], starts, result.landmarks, prior)
        statistics["keyframes"] = len(keys)
    return {
        "T_world_camera": poses,
        "depth_gain": result.depth_gain,
        "depth_gain_sigma": result.depth_gain_sigma if options["estimate_gain"] else None,
        "pose_sigma_m": result.residual_m,
        "warnings": tuple(result.warnings),
        "statistics": {
            **statistics,
            "residual_m": {f.name: float(r) for f, r in zip(frames, residual, strict=True)},
        },
    }


BACKEND = Backend(solve, pointmaps)
