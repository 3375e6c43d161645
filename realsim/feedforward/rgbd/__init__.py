"""Poses and points from sensor depth: given poses are checked and refined, absent ones are estimated."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.errors import PoseError
from realsim.core.types import Dropped, Frame, FrameSet, PointView, Solution
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses in metres by the sensor's depth, in the capture's world if its poses can be used, else the first camera's.

    Frames that do not fit are left out and named. With metric poses given, the depth sensor's gain comes with it.
    What moves with the camera is left out: sought under given poses before these are judged, else among features that
    keep their place and under the poses that were found, which are then found again without it.

    Raises:
        PoseError: see `realsim.feedforward.solve`.
    """
    from realsim.feedforward.rgbd.ego_mask import describe_ego_mask, find_ego_mask, mask_out

    given = _choose_posed(frames, config)
    if given is not None and frames.poses_metric:
        posed = [frames.frames[i] for i in given]
        cells = find_ego_mask(posed, np.stack([f.T_world_camera for f in posed if f.T_world_camera is not None]))
    else:
        first = _solve_once(frames, given, config)
        cells = find_ego_mask([frames.frames[i] for i in first.used], first.T_world_camera)
        cells = first.arrays.get("carried") if cells is None else cells
        if cells is None:
            return first
    if cells is None:
        return _solve_once(frames, given, config)
    masked = replace(frames, frames=tuple(mask_out(f, cells) for f in frames.frames))
    solution = _solve_once(masked, given, config)
    statistics = {**solution.statistics, "left_out": [describe_ego_mask(cells)]}
    return replace(solution, arrays={**solution.arrays, "carried": cells}, statistics=statistics)


def load_views(used: tuple[Frame, ...], solution: Solution) -> tuple[tuple[Frame, ...], Callable[[int], PointView]]:
    """Views from corrected sensor depth (`solution.depth_gain` times the sensor's), camera frame, metres."""
    from realsim.feedforward.rgbd.ego_mask import mask_out
    from realsim.feedforward.rgbd.extrinsic_calibration import Registration
    from realsim.feedforward.rgbd.views import point_view

    if (cells := solution.arrays.get("carried")) is not None:
        used = tuple(mask_out(f, cells) for f in used)
    for row in solution.arrays.get("registration", ()):
        used = tuple(Registration.of(row).applied(f) for f in used)
    return used, lambda i: point_view(used[i], solution.depth_gain)


def _choose_posed(frames: FrameSet, config: PointsConfig) -> list[int] | None:
    """Indices of the frames whose given poses are to be used, or None if poses are to be estimated."""
    if config.poses == "estimate":
        return None
    posed = [i for i, f in enumerate(frames.frames) if f.T_world_camera is not None]
    if config.poses == "given" and not posed:
        raise PoseError(
            "no poses in the capture", file=frames.source, hint="use --poses estimate to have them estimated"
        )
    return posed if config.poses == "given" or 2 * len(posed) > len(frames) else None


def _solve_once(frames: FrameSet, given: list[int] | None, config: PointsConfig) -> Solution:
    """Colour registered, poses checked or estimated, and all adjusted together."""
    if given is None and len(frames) == 1:
        return Solution((0,), np.eye(4)[None], world_is_capture=False, statistics={"poses": "one frame"})
    return _estimate(frames, config) if given is None else _refine_given(frames, given, config)


def _refine_given(frames: FrameSet, posed: list[int], config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.accept_refinement import refine_or_keep
    from realsim.feedforward.rgbd.check_poses import check_poses, measure_scale
    from realsim.feedforward.rgbd.register_color import register_color, register_color_under

    chosen = [frames.frames[i] for i in posed]
    T = np.stack([f.T_world_camera for f in chosen if f.T_world_camera is not None])
    colour = register_color(chosen, frames.source, config.seed)
    notes: tuple[str, ...] = ()
    if not frames.poses_metric:
        factor, error = measure_scale(colour.evidence, T)
        T[:, :3, 3] *= factor
        notes = (
            f"the given poses are not in metres: their positions, and with them their world, were multiplied by "
            f"{factor:.4g} (± {error:.1%}), as the depth says",
        )
    check = check_poses(
        colour.frames,
        T,
        evidence=colour.evidence,
        seed=config.seed,
        sensor_sigma=frames.sensor_sigma,
        source=frames.source,
    )
    keep = check.kept(chosen)
    found: dict[str, Any] = {"T_world_camera": T[keep], "statistics": {"poses": "given"}, "warnings": ()}
    if config.refine:
        gain = config.correct_depth_bias and frames.poses_metric
        options: dict[str, Any] = {"estimate_gain": gain, "sensor_sigma": frames.sensor_sigma, "seed": config.seed}
        if len(colour.corrections):
            colour = register_color_under(T, colour, keep, options)
        found = refine_or_keep([colour.frames[k] for k in keep], T[keep], colour.evidence.subset(keep), **options)
    found["statistics"] |= {"check": dict(check.statistics), **colour.statistics}
    found["warnings"] = notes + colour.warnings + check.warnings + found["warnings"]
    unposed = tuple(Dropped(f.name, "has no pose") for f in frames.frames if f.T_world_camera is None)
    return Solution(
        used=tuple(posed[k] for k in keep),
        world_is_capture=True,
        dropped=unposed + check.contradicting,
        arrays={"registration": colour.corrections},
        **found,
    )


def _estimate(frames: FrameSet, config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.align_to_given import align_to_given
    from realsim.feedforward.rgbd.ego_mask import find_still_cells, mask_out
    from realsim.feedforward.rgbd.estimate import estimate
    from realsim.feedforward.rgbd.refine import refine
    from realsim.feedforward.rgbd.register_color import register_color

    colour = register_color(frames.frames, frames.source, config.seed)
    cells = find_still_cells(colour.evidence.views, config.seed)
    if cells is not None:
        colour = register_color([mask_out(f, cells) for f in frames.frames], frames.source, config.seed)
    result = estimate(colour.evidence.views, config.seed, config.learned_matches)
    found: dict[str, Any] = {"T_world_camera": result.T_world_camera, "statistics": {}, "warnings": ()}
    if result.statistics.get("by_shape"):  # without features nothing has looked at all views at once yet
        used, own = [colour.frames[i] for i in result.used], colour.evidence.subset(result.used)
        options: dict[str, Any] = {"estimate_gain": False, "trust": "estimated", "seed": config.seed}
        found = refine(used, result.T_world_camera, evidence=own, **options).fields(used)
    found["statistics"] = {**found["statistics"], "poses": "estimated", **result.statistics, **colour.statistics}
    found["warnings"] = colour.warnings + result.warnings + found["warnings"]
    dropped = tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(result.lost.items()))
    found = align_to_given(found, [frames.frames[i] for i in result.used], frames, config.correct_depth_bias)
    arrays = {"registration": colour.corrections} | ({} if cells is None else {"carried": cells})
    return Solution(used=result.used, dropped=dropped, arrays=arrays, **found)


def _inputs(config: PointsConfig) -> tuple[Path, ...]:
    from realsim.feedforward import matcher

    return matcher.FILES if config.learned_matches else ()


BACKEND = Backend(solve, load_views, _inputs)
