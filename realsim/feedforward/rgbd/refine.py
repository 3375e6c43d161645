"""Camera poses adjusted together, and the depth sensor's scale recovered where the poses are metric.

    evidence = Evidence.of(frames)
    check = check_poses(frames, T, evidence=evidence)          # check_poses.py: refuses or names what contradicts
    found = refine(frames, T, estimate_gain=True, trust="metric", evidence=evidence)

With metric poses the depth gain is what makes triangulated and measured depth agree; how much the given poses are
believed is found from the data (refine_adjust.py), so exact poses stay where they are and noisy ones move. Poses that
were estimated from the depth go through the same adjustment with a prior that only fixes what the data leave free.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from realsim.core.errors import PoseError
from realsim.core.geometry import invert_T, is_rotation
from realsim.core.types import F64, Frame
from realsim.feedforward.rgbd.bias import judge_gain
from realsim.feedforward.rgbd.features import Evidence, Match, Tracks, View, build_tracks
from realsim.feedforward.rgbd.heldout import hold_out
from realsim.feedforward.rgbd.keyframes import choose_by_poses
from realsim.feedforward.rgbd.localize import SIGMA_INVERSE, SIGMA_PX, Landmarks, localize
from realsim.feedforward.rgbd.loop_closure import keep_plausible
from realsim.feedforward.rgbd.matching import match_guided
from realsim.feedforward.rgbd.refine_adjust import Sigmas, State, Step, initial_state, solve_step
from realsim.feedforward.rgbd.refine_pairs import Surface, associate, choose_overlapping, choose_pairs, sample_surface

STEPS = 12
SAMPLES = 300
"""Surface points a view."""
LOOSE = Sigmas(position=0.5, angle=0.2)
"""Prior on estimated poses: weak, so that it only fixes what the data leave free."""
FEATURES = Sigmas(SIGMA_PX, SIGMA_INVERSE, position=0.5, angle=0.2)
"""Of estimated poses and features alone, whose noise is known."""
UNFIT = 5.0
"""Standard deviations beyond which an observation takes no part in the second adjustment to features."""

Trust = Literal["metric", "estimated", "features"]


@dataclass(frozen=True)
class RefineResult:
    """Refined poses and the depth gain."""

    T_world_camera: F64
    """(N, 4, 4) camera to the world of the given poses, metres."""
    depth_gain: float
    """Corrected depth = gain * sensor depth; 1 where it was not requested or cannot be determined."""
    depth_gain_sigma: float
    """Its standard error; infinite where the gain was not requested."""
    residual_m: float
    """Median over keyframes of `per_frame_residual_m`, metres."""
    per_frame_residual_m: F64
    """(N,) robust RMS distance between a frame's points and the same points as other frames see them; NaN if none."""
    warnings: tuple[str, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    """JSON-able; `sigma_z_over_z2` (1/m) is the sensor's depth noise a in sigma = a * depth^2, as it remains after a
    fit over 5x5 pixels: noise that neighbouring pixels share, which no local smoothing removes."""
    held_out: tuple[tuple[int, int], ...] = ()
    """Pairs of frames that see the same and took no part."""

    def fields(self, frames: Sequence[Frame]) -> dict[str, Any]:
        """Fields of a `Solution`."""
        residual = {f.name: float(r) for f, r in zip(frames, self.per_frame_residual_m, strict=True)}
        return {
            "T_world_camera": self.T_world_camera,
            "depth_gain": self.depth_gain,
            "depth_gain_sigma": self.depth_gain_sigma if np.isfinite(self.depth_gain_sigma) else None,
            "pose_sigma_m": self.residual_m,
            "warnings": self.warnings,
            "statistics": {**self.statistics, "residual_m": residual},
        }


def refine(
    frames: Sequence[Frame],
    T_world_camera: F64,
    *,
    estimate_gain: bool,
    trust: Trust,
    seed: int = 0,
    evidence: Evidence | None = None,
    sensor_sigma: float = 0.006,
) -> RefineResult:
    """Refine poses by features with depth and by surfaces; see the module's text.

    Of a dense capture keyframes are refined together, the others follow them.

    Args:
        frames: N frames.
        T_world_camera: (N, 4, 4) camera to world, OpenCV axes, metres.
        estimate_gain: also recover the depth gain. Needs `trust="metric"`.
        trust: `metric`: the poses come from a metric source with an unknown error; they give the scale.
            `estimated`: the poses were found from the depth, so the depth gives the scale (`features`: and so do
            features alone).
        seed: of the choice of samples.
        evidence: `Evidence.of(frames)`, if it is there already (of exactly these frames).
        sensor_sigma: relative standard error of the depth sensor's own scale before anything was seen.

    Raises:
        PoseError: poses of wrong number, not finite, or not rigid; a gain requested without metric poses.
    """
    T = _checked(frames, T_world_camera)
    if estimate_gain and trust != "metric":
        raise PoseError("a depth gain cannot be estimated from poses that were computed from the same depth")
    evidence = evidence or Evidence.of(frames, seed)
    keys, followers = choose_by_poses(evidence.views, T)
    own = evidence.subset(keys) if followers else evidence
    pairs, held_out = hold_out(choose_pairs(own.views, T[keys]))
    matches = keep_plausible(own, pairs, T[keys])
    tracks = build_tracks(own.views, matches)
    step, surface, given = adjust(
        own.views, T[keys], tracks, pairs, estimate_gain=estimate_gain, trust=trust, seed=seed
    )
    gain = judge_gain(step, tracks, surface, len(keys), sensor_sigma if estimate_gain else None)
    sigmas = step.sigmas
    moved = np.linalg.norm(step.state.c - given.c, axis=1)
    turn = np.trace(step.state.R @ np.swapaxes(given.R, 1, 2), axis1=1, axis2=2)
    angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
    statistics: dict[str, Any] = {
        "pairs": len(pairs),
        "matched_pairs": len(matches),
        "tracks": tracks.count,
        "observations": len(tracks.z),
        "surface_samples": len(surface.i),
        "image_sigma_px": sigmas.image if tracks.count else None,
        "sigma_z_over_z2": sigmas.depth if tracks.count else sigmas.surface / np.sqrt(2),
        "surface_sigma_over_z2": sigmas.surface,
        "moved_rms_m": float(np.sqrt((moved**2).mean())),
        "turned_rms_deg": float(np.sqrt((angle**2).mean())),
        "depth_gain": gain.statistics,
    }
    if trust == "metric":
        statistics["given_position_sigma_m"] = sigmas.position
        statistics["given_angle_sigma_deg"] = float(np.degrees(sigmas.angle))
    poses, residual = T.copy(), np.full(len(T), np.nan)
    poses[keys], residual[keys] = step.state.T, _per_frame(step, tracks, surface, len(keys))
    middle = float(np.nanmedian(residual)) if np.isfinite(residual).any() else float("nan")
    warnings = gain.warnings + _warnings(own.views, tracks, residual[keys])
    if followers:
        rest = list(followers)
        starts = np.stack([poses[key] @ motion for key, motion in followers.values()])
        known = Landmarks(own.views, step.state.T, tracks, step.state.X, step.state.gain)
        prior = (step.sigmas.position, step.sigmas.angle) if trust == "metric" else None
        poses[rest], residual[rest] = localize([evidence.views[k] for k in rest], starts, known, prior)
        statistics["keyframes"] = len(keys)
    apart = tuple((keys[i], keys[j]) for i, j in held_out)
    return RefineResult(poses, gain.value, gain.sigma, middle, residual, warnings, statistics, apart)


def match_and_adjust(
    views: Sequence[View], T: F64, kept: Sequence[Match] = (), seed: int = 0
) -> tuple[Landmarks | None, dict[str, Any]]:
    """Match all overlapping pairs anew under guidance of estimated poses, which closes loops, and adjust.

    Args:
        kept: matches of features that have no descriptor; they stay as they are.
    """
    pairs = choose_overlapping(views, T)
    guided = (match_guided(views, i, j, invert_T(T[i]) @ T[j]) for i, j in pairs)
    matches = [*filter(None, guided), *kept]
    if not matches:
        return None, {}
    step, tracks = adjust_to_features(T, build_tracks(views, matches), seed, views, pairs)
    return Landmarks(views, step.state.T, tracks, step.state.X), {
        "matched_pairs": len(matches),
        "tracks": tracks.count,
        "observations": len(tracks.z),
        "median_px": float(np.median(np.hypot(*step.track_residual[:, :2].T))),
        "median_inverse_depth": float(np.median(np.abs(step.track_residual[:, 2]))),
    }


def adjust_to_features(
    T: F64, tracks: Tracks, seed: int = 0, views: Sequence[View] = (), pairs: Sequence[tuple[int, int]] = ()
) -> tuple[Step, Tracks]:
    """The last step of the adjustment of estimated poses to features with depth, done twice: the second time without
    the observations that the first did not fit, and with the surfaces of `pairs`. And the tracks that are left.

    Features weigh a hundred times as much as surfaces where there are many; where there are few, surfaces decide.
    """
    step, _, _ = adjust((), T, tracks, trust="features", seed=seed)
    x, y, depth = np.abs(step.track_residual.T) / ([FEATURES.image], [FEATURES.image], [FEATURES.depth])
    tracks = tracks.where((np.hypot(x, y) < UNFIT) & (depth < UNFIT))
    return adjust(views, step.state.T, tracks, pairs, trust="features", seed=seed)[0], tracks


def _checked(frames: Sequence[Frame], T: F64) -> F64:
    T = np.asarray(T, float)
    if T.shape != (len(frames), 4, 4):
        raise PoseError("poses do not fit the frames", expected=f"({len(frames)}, 4, 4)", found=str(T.shape))
    for frame, pose in zip(frames, T, strict=True):
        if not np.isfinite(pose).all() or not is_rotation(pose[:3, :3], 1e-3):
            raise PoseError(f"the pose of frame {frame.name} is not a rigid motion")
    return T


def adjust(
    views: Sequence[View],
    T: F64,
    tracks: Tracks,
    pairs: Sequence[tuple[int, int]] = (),
    *,
    estimate_gain: bool = False,
    trust: Trust,
    seed: int = 0,
) -> tuple[Step, Surface, State]:
    """The last step of the adjustment of poses (N, 4, 4) to tracks and to the surfaces of `pairs`, what surface it
    compared, and the state that it began with.

    Surfaces are associated anew at each step, within a gate that narrows.
    """
    rng = np.random.default_rng(seed)
    samples = [sample_surface(view, rng, SAMPLES) for view in views] if pairs else []
    state = given = initial_state(T, tracks)
    sigmas = {"metric": Sigmas(), "estimated": LOOSE, "features": FEATURES}[trust]
    for k in range(STEPS):
        surface = associate(views, samples, state.T, state.gain, pairs, gate=max(0.02, 0.08 * 0.6**k))
        # The first steps only bring the residuals down to noise; what they say about the poses' error is not yet true.
        fit_prior = trust == "metric" and k >= 2
        step = solve_step(
            state,
            given,
            tracks,
            surface,
            sigmas,
            estimate_gain=estimate_gain,
            fit_prior=fit_prior,
            seed=seed,
            fit_sigmas=trust != "features",
        )
        done = k >= 6 and step.move < 5e-5 and abs(step.state.log_gain - state.log_gain) < 2e-5
        state, sigmas = step.state, step.sigmas
        if done:
            break
    return step, surface, given


def _per_frame(step: Step, tracks: Tracks, surface: Surface, n: int) -> F64:
    """(N,) 1.4826 * median |residual| in metres of depth at features and of surfaces."""
    meters = np.concatenate([step.track_residual[:, 2] * tracks.z**2, step.surface_residual * surface.z**2])
    owner = np.concatenate([tracks.view, surface.i])
    out = np.full(n, np.nan)
    order = np.argsort(owner, kind="stable")
    size, edges = np.abs(meters[order]), np.searchsorted(owner[order], np.arange(n + 1))
    for k, (start, end) in enumerate(pairwise(edges)):
        if end - start >= 20:
            out[k] = 1.4826 * np.median(size[start:end])
    return out


def _warnings(views: Sequence[View], tracks: Tracks, per_frame: F64) -> tuple[str, ...]:
    out = []
    if not tracks.count:
        what = "without colour" if not any(v.has_color for v in views) else "without matching features"
        out.append(f"poses were refined by surfaces alone ({what}): sliding along flat surfaces is not detected")
    loose = [v.name for v, r in zip(views, per_frame, strict=True) if not np.isfinite(r)]
    if loose:
        many = f"{len(loose)} frame{'s' * (len(loose) != 1)}"
        out.append(f"no neighbours to refine against for {many} (pose kept): {', '.join(loose[:5])}")
    return tuple(out)
