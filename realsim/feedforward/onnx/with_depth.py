"""A feed-forward model and the depth sensor together: each for what it is good at.

Poses: the capture's if it has metric ones; else the model's, in metres by the sensor's depth and then refined against
it. Points: the sensor's wherever it measured; the model's where the sensor saw nothing, pulled onto the sensor's depth
around the hole, and only where the two agree there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from realsim.core.errors import PoseError, ScaleError
from realsim.core.types import F32, F64, Bool, Dropped, Frame, FrameSet, PointView, Solution
from realsim.feedforward import rgbd
from realsim.feedforward.backend import Backend
from realsim.feedforward.config import PointsConfig
from realsim.feedforward.onnx import model_file, model_files
from realsim.feedforward.onnx.preprocess import depth_to_grid
from realsim.feedforward.onnx.runner import Views, predict, without
from realsim.feedforward.onnx.session import Model, open_model
from realsim.feedforward.onnx.views import pack, predicted_depth
from realsim.feedforward.rgbd.features import Evidence, Match

FEW = 200
"""Pixels with both depths below which a frame says nothing about scale."""
AGREES = 0.04
"""Relative: how far the model's depth may vary against the sensor's around a hole that it fills."""
REACH = 1 / 10
"""Share of the image's width over which the sensor around a hole speaks for what is in it."""
NEAR = (0.2, 0.15)
"""Metres and radians that features may contradict a model's motion between two views."""
TRUST = 0.5
"""Largest weight of a completed pixel relative to a measured one."""


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses in metres by the sensor's depth; `arrays` hold the model's depth in its own unit, as for `onnx`.

    Raises:
        ModelError, CaptureError: see `realsim.feedforward.onnx.runner.predict`.
        PoseError: the model's poses contradict the depth.
        ScaleError: no frame has depth to compare with.
    """
    model = open_model(model_file(config), config.onnx.provider)
    posed = config.poses == "given" or (config.poses == "auto" and frames.has_poses)
    if posed or model.spec.kind == "mono":
        return _completing(frames, model, config)
    views = _predict(frames.frames, model, config, poses=True)
    chosen = [frames.frames[i] for i in views.used]
    scale, spread = metres(views, chosen)
    T = views.T_world_camera.copy()
    T[:, :3, 3] *= scale
    refined, kept, contradicting = _refined(chosen, T, config.seed)
    views = without(views, {views.used[k]: why for k, why in contradicting.items()})
    first = np.linalg.inv(refined.T_world_camera[0])
    return replace(
        refined,
        used=views.used,
        T_world_camera=first @ refined.T_world_camera,
        metric_claim=None if views.metric_claim is None else views.metric_claim / scale,
        dropped=tuple(Dropped(frames.frames[i].name, why) for i, why in sorted(views.lost.items())),
        warnings=(*views.warnings, *refined.warnings),
        statistics={
            "poses": "by the model, refined against the depth",
            **views.statistics,
            "model_scale": scale,
            "model_scale_spread": spread,
            "pose_correction": _moved(T[kept], refined.T_world_camera),
            "refinement": dict(refined.statistics),
        },
        arrays=pack(views),
    )


def load_views(used: tuple[Frame, ...], solution: Solution) -> tuple[tuple[Frame, ...], Callable[[int], PointView]]:
    """Views from corrected sensor depth, completed by the model; camera frame, metres."""
    frames, load = rgbd.load_views(used, solution)
    return frames, lambda i: completed(load(i), used[i], solution.depth_gain, solution.arrays, i)


def completed(view: PointView, frame: Frame, gain: float, arrays: Mapping[str, np.ndarray], i: int) -> PointView:
    """The sensor's view with the model's depth where the sensor measured nothing at all."""
    sensor = frame.depth() * np.float32(gain)
    sensor = np.where(np.isfinite(sensor) & (sensor > 0), sensor, 0).astype(np.float32)
    model, conf, mask = predicted_depth(frame, arrays, i)
    pulled, agrees = onto_sensor(model, mask, sensor)
    new = mask & agrees & (sensor == 0)
    z = np.where(new, pulled, view.points[..., 2])
    points = np.where(new[..., None], frame.intrinsics.rays() * z[..., None], view.points)
    known = float(np.median(view.confidence[view.mask])) if view.mask.any() else 1.0
    confidence = np.where(new, TRUST * known * conf, view.confidence)
    return PointView(points.astype(np.float32), confidence.astype(np.float32), view.mask | new, view.color)


def onto_sensor(model: F32, mask: Bool, sensor: F32) -> tuple[F32, Bool]:
    """The model's depth (H, W) times the smoothed ratio sensor / model around, and where that ratio is steady.

    A model is right about the shape of a surface and less so about its distance: the ratio differs between places.
    What is filled in must meet the measured rim without a step.
    """
    import cv2

    both = mask & (sensor > 0)
    log = np.zeros_like(model)
    log[both] = np.log(sensor[both] / model[both])
    width = max(model.shape[1] * REACH, 2.0)
    weight = both.astype(np.float32)

    def smooth(values: F32) -> F32:
        return np.asarray(cv2.GaussianBlur(values.astype(np.float32), (0, 0), width / 2), np.float32)

    total = smooth(weight)
    mean = smooth(log * weight) / np.maximum(total, 1e-6)
    spread = np.sqrt(np.maximum(smooth(log**2 * weight) / np.maximum(total, 1e-6) - mean**2, 0))
    return (model * np.exp(mean)).astype(np.float32), (total > 0.02) & (spread < AGREES)


def metres(views: Views, frames: list[Frame]) -> tuple[float, float]:
    """(metres per unit, relative spread between frames) by the median ratio of depths.

    Raises:
        ScaleError: no frame has depth where the model is sure.
    """
    logs = []
    for k, frame in enumerate(frames):
        sensor = depth_to_grid(frame.depth(), frame.intrinsics, views.grids[k])
        both = (views.depth[k] > 0) & (sensor > 0)
        if np.count_nonzero(both) >= FEW:
            logs.append(float(np.median(np.log(sensor[both] / views.depth[k][both]))))
    if not logs:
        raise ScaleError(
            "the model's depth cannot be compared with the sensor's", expected=f"{FEW} pixels that both know",
            found=f"fewer in each of {len(frames)} frames", hint="use --backend onnx on a capture with depth",
        )  # fmt: skip
    middle = float(np.median(logs))
    return float(np.exp(middle)), float(1.4826 * np.median(np.abs(np.array(logs) - middle)))


def _predict(frames: tuple[Frame, ...], model: Model, config: PointsConfig, *, poses: bool) -> Views:
    return predict(frames, model, config.onnx, with_depth=True, poses=poses, kept_in=config.onnx.kept_in)


def _completing(frames: FrameSet, model: Model, config: PointsConfig) -> Solution:
    """Poses by the depth (or as given); from the model only what the depth did not see."""
    base = rgbd.solve(frames, config)
    views = _predict(tuple(frames.frames[i] for i in base.used), model, config, poses=False)
    # What the model cannot say about a frame is no reason to lose the frame: it just completes nothing there.
    n, (h, w) = len(base.used), views.depth.shape[1:]
    depth, conf = np.zeros((n, h, w), np.float32), np.zeros((n, h, w), np.float32)
    depth[list(views.used)], conf[list(views.used)] = views.depth, views.conf
    grids = dict(zip(views.used, views.grids, strict=True))
    whole = replace(views, depth=depth, conf=conf, grids=tuple(grids.get(i, views.grids[0]) for i in range(n)))
    silent = [frames.frames[base.used[i]].name for i in sorted(views.lost)]
    notes = (f"the model completes nothing in {len(silent)} frames: {', '.join(silent[:5])}",) if silent else ()
    return replace(
        base,
        warnings=(*base.warnings, *views.warnings, *notes),
        statistics={**base.statistics, "model": dict(views.statistics)},
        arrays=pack(whole),
    )


class _Nearby(Evidence):
    """Only matches that the model's poses do not contradict: repeated texture matches well in wrong places, and one
    such pair carried a frame away by a metre."""

    def __init__(self, evidence: Evidence, T_world_camera: F64) -> None:
        super().__init__(evidence.views, evidence.seed)
        self._all, self._T = evidence, T_world_camera

    def matches(self, pairs: Sequence[tuple[int, int]]) -> list[Match]:
        """Verified matches of those pairs whose motion is near the model's."""
        return [m for m in self._all.matches(pairs) if self._near(m)]

    def subset(self, keep: Sequence[int]) -> Evidence:
        """The same for some of the views, renumbered."""
        return _Nearby(self._all.subset(keep), self._T[list(keep)])

    def _near(self, m: Match) -> bool:
        E = np.linalg.inv(m.T_i_j) @ np.linalg.inv(self._T[m.i]) @ self._T[m.j]
        turned = np.arccos(np.clip((np.trace(E[:3, :3]) - 1) / 2, -1, 1))
        return bool(np.linalg.norm(E[:3, 3]) < NEAR[0] and turned < NEAR[1])


def _refined(frames: list[Frame], T: F64, seed: int) -> tuple[Solution, list[int], dict[int, str]]:
    """Poses (N, 4, 4) refined against the depth, and without those that still contradict it.

    Returns:
        The solution, the indices of the frames kept, and index -> why of the others.
    """
    from realsim.feedforward.rgbd.check_poses import check_poses
    from realsim.feedforward.rgbd.refine import match_and_adjust, refine

    if len(frames) == 1:
        return Solution((0,), T, world_is_capture=False), [0], {}
    evidence = Evidence.of(frames, seed)
    nearby = _Nearby(evidence, T)
    found = refine(frames, T, estimate_gain=False, trust="estimated", seed=seed, evidence=nearby)
    # Now that a feature's place is known to a pixel or two, matching under guidance finds more, and drift goes.
    landmarks, adjusted = match_and_adjust(evidence.views, found.T_world_camera)
    poses = found.T_world_camera if landmarks is None else landmarks.T_world_camera
    try:
        check = check_poses(frames, poses, evidence=nearby, seed=seed)
    except PoseError as error:
        raise PoseError(
            "the model's poses contradict the depth, even when refined against it", found=error.found,
            hint="use --backend rgbd, which needs no model, or --backend onnx, which believes the model alone",
        ) from error  # fmt: skip
    keep = check.kept(frames)
    reasons = {d.name: d.reason for d in check.contradicting}
    solution = Solution(
        used=tuple(keep),
        T_world_camera=poses[keep],
        world_is_capture=False,
        pose_sigma_m=found.residual_m,
        warnings=(*found.warnings, *check.warnings),
        statistics={**found.statistics, **adjusted, "check": dict(check.statistics)},
    )
    return solution, keep, {k: reasons[f.name] for k, f in enumerate(frames) if f.name in reasons}


def _moved(before: F64, after: F64) -> dict[str, float]:
    """How far refinement moved the model's cameras against each other."""
    a, b = (np.linalg.inv(T[0]) @ T for T in (before, after))
    turn = np.trace(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3], axis1=1, axis2=2)
    return {
        "median_m": float(np.median(np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1))),
        "median_deg": float(np.degrees(np.median(np.arccos(np.clip((turn - 1) / 2, -1, 1))))),
    }


BACKEND = Backend(solve, load_views, model_files)
