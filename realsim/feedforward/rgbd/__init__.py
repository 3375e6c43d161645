"""Poses and points from sensor depth: given poses are checked and refined, absent ones are estimated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from realsim.core.errors import PoseError
from realsim.core.types import F64, Dropped, Frame, FrameSet, PointView, Solution
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig

if TYPE_CHECKING:
    from realsim.feedforward.rgbd.features import Evidence


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


def _solve_once(frames: FrameSet, given: list[int] | None, config: PointsConfig) -> Solution:
    return _solve_estimated(frames, config) if given is None else _solve_given(frames, given, config)


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


def _solve_given(frames: FrameSet, posed: list[int], config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.accept_refinement import refine_or_keep
    from realsim.feedforward.rgbd.check_poses import check_poses, measure_scale

    chosen = [frames.frames[i] for i in posed]
    T = np.stack([f.T_world_camera for f in chosen if f.T_world_camera is not None])
    said: tuple[str, ...] = ()
    chosen, evidence, registration, noted = _register_color(chosen, frames.source, config.seed)
    if not frames.poses_metric:
        factor, error = measure_scale(evidence, T)
        T[:, :3, 3] *= factor
        said = (
            f"the given poses are not in metres: their positions, and with them their world, were multiplied by "
            f"{factor:.4g} (± {error:.1%}), as the depth says",
        )
    check = check_poses(
        chosen, T, evidence=evidence, seed=config.seed, sensor_sigma=frames.sensor_sigma, source=frames.source
    )
    keep = check.kept(chosen)
    gain = config.correct_depth_bias and frames.poses_metric
    options: dict[str, Any] = {"estimate_gain": gain, "sensor_sigma": frames.sensor_sigma, "seed": config.seed}
    if config.refine and len(registration):
        chosen, evidence, registration = _register_color_under(T, chosen, evidence, keep, registration, noted, options)
    found: dict[str, Any] = {"T_world_camera": T[keep], "statistics": {"poses": "given"}, "warnings": ()}
    if config.refine:
        found = refine_or_keep([chosen[k] for k in keep], T[keep], evidence.subset(keep), **options)
    found["statistics"] |= {"check": dict(check.statistics), **noted}
    found["warnings"] = said + _describe_registration(noted) + check.warnings + found["warnings"]
    unposed = tuple(Dropped(f.name, "has no pose") for f in frames.frames if f.T_world_camera is None)
    return Solution(
        used=tuple(posed[k] for k in keep),
        world_is_capture=True,
        dropped=unposed + check.contradicting,
        arrays={"registration": registration},
        **found,
    )


def _solve_estimated(frames: FrameSet, config: PointsConfig) -> Solution:
    from realsim.feedforward.rgbd.accept_refinement import refine_all
    from realsim.feedforward.rgbd.align_to_given import align_to_given
    from realsim.feedforward.rgbd.ego_mask import find_still_cells, mask_out
    from realsim.feedforward.rgbd.estimate import estimate

    if len(frames) == 1:
        return Solution((0,), np.eye(4)[None], world_is_capture=False, statistics={"poses": "one frame"})
    chosen, evidence, registration, noted = _register_color(frames.frames, frames.source, config.seed)
    cells = find_still_cells(evidence.views, config.seed)
    if cells is not None:
        bare = [mask_out(f, cells) for f in frames.frames]
        chosen, evidence, registration, noted = _register_color(bare, frames.source, config.seed)
    result = estimate(evidence.views, config.seed, config.learned_matches)
    found: dict[str, Any] = {"T_world_camera": result.T_world_camera, "statistics": {}, "warnings": ()}
    if result.statistics.get("by_shape"):  # without features nothing has looked at all views at once yet
        used = [chosen[i] for i in result.used]
        refined = refine_all(
            used,
            result.T_world_camera,
            evidence.subset(result.used),
            estimate_gain=False,
            trust="estimated",
            seed=config.seed,
        )
        found = refined.fields(used)
    found["statistics"] = {**found["statistics"], "poses": "estimated", **result.statistics, **noted}
    found["warnings"] = _describe_registration(noted) + result.warnings + found["warnings"]
    dropped = tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(result.lost.items()))
    found = align_to_given(found, [frames.frames[i] for i in result.used], frames, config.correct_depth_bias)
    arrays = {"registration": registration} | ({} if cells is None else {"carried": cells})
    return Solution(used=result.used, dropped=dropped, arrays=arrays, **found)


def _register_color(
    frames: Sequence[Frame], source: Path, seed: int
) -> tuple[list[Frame], Evidence, F64, dict[str, Any]]:
    """Frames with their colour camera corrected where matches show that it is another one, their evidence, the (K, 5)
    corrections in their order, and statistics.

    Raises:
        PoseError: colour and depth are not of one view at one time.
    """
    from realsim.feedforward.rgbd.depth_colour_sync import check_together
    from realsim.feedforward.rgbd.extrinsic_calibration import calibrate, choose_nearby
    from realsim.feedforward.rgbd.features import Evidence

    evidence = Evidence.of(frames, seed)
    check_together(evidence.views, source, seed)
    chosen: list[Frame] = list(frames)
    applied: list[F64] = []
    statistics: dict[str, Any] = {}
    for _ in range(3):  # right rays match more, which makes them righter
        found = calibrate(evidence.views, evidence.matches(choose_nearby(len(chosen))))
        if found is None:
            break
        use = found.clear or (bool(applied) and found.after < found.before)
        statistics.setdefault("registration", []).append({**found.summary(), "applied": use})
        if not use:
            break
        applied.append(found.registration.row)
        chosen = [found.registration.applied(f) for f in chosen]
        evidence = Evidence.of(chosen, seed)
    return chosen, evidence, np.array(applied).reshape(-1, 5), statistics


def _register_color_under(
    T: F64,
    frames: list[Frame],
    evidence: Evidence,
    keep: list[int],
    registration: F64,
    noted: Mapping[str, Any],
    options: Mapping[str, Any],
) -> tuple[list[Frame], Evidence, F64]:
    """As `_register_color`, where colour turned out to be another camera and poses are given: surfaces alone refine
    these, and matches under them tell where that camera is. Features, which refine the poses next, would else pull them
    to where the colour camera is taken to be."""
    from realsim.feedforward.rgbd.accept_refinement import refine_all
    from realsim.feedforward.rgbd.extrinsic_calibration import calibrate
    from realsim.feedforward.rgbd.features import Evidence
    from realsim.feedforward.rgbd.loop_closure import keep_plausible
    from realsim.feedforward.rgbd.refine_pairs import choose_pairs

    own = evidence.subset(keep)
    alone = refine_all([frames[k] for k in keep], T[keep], own.without_color(), trust="metric", **options)
    poses = alone.T_world_camera
    matches = keep_plausible(own, choose_pairs(own.views, poses), poses)
    found = calibrate(own.views, matches, poses, alone.result.depth_gain)
    if found is None or found.after >= found.before:
        return frames, evidence, registration
    noted["registration"].append({**found.summary(), "applied": True})
    frames = [found.registration.applied(f) for f in frames]
    return frames, Evidence.of(frames, options["seed"]), np.vstack([registration, found.registration.row])


def _describe_registration(noted: Mapping[str, Any]) -> tuple[str, ...]:
    clear = [r for r in noted.get("registration", ()) if r["applied"]]
    if not clear:
        return ()
    zoom = float(np.prod([r["zoom"] for r in clear]))
    shift = 1e3 * np.sum([r["shift_m"] for r in clear], axis=0)
    return (
        f"colour is not registered to depth as the capture has it: its focal length is {1 / zoom - 1:+.1%} of what was "
        f"read, and its camera {shift[0]:.0f} mm to the side; estimated from the frames and corrected",
    )


def _inputs(config: PointsConfig) -> tuple[Path, ...]:
    from realsim.feedforward import matcher

    return matcher.FILES if config.learned_matches else ()


BACKEND = Backend(solve, load_views, _inputs)
