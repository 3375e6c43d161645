"""Given poses are a baseline: what is delivered is the first proposal that held-out pairs do not find worse.

The proposals, in this order: poses refined with the sensor's gain; the same without a gain, where the gain is more than
the sensor can be off and the surfaces alone do not confirm it; poses refined by surfaces alone; the poses as given.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from realsim.core.types import F64, Frame
from realsim.feedforward.rgbd.features import Evidence
from realsim.feedforward.rgbd.heldout import compare
from realsim.feedforward.rgbd.keyframes import choose_by_poses
from realsim.feedforward.rgbd.localize import localize
from realsim.feedforward.rgbd.refine import RefineResult, refine

WORTH_TELLING = 0.02
"""Relative difference between the scale of poses and depth from which a warning is given."""
UNUSUAL = 3.0
"""Standard deviations of the sensor's own scale beyond which surfaces without colour must confirm a gain."""


@dataclass(frozen=True)
class Refined:
    """A refinement of all frames: keyframes together, the rest after them."""

    result: RefineResult
    """Of the keyframes."""
    keys: list[int]
    T_world_camera: F64
    """(N, 4, 4) of all frames."""
    residual_m: F64
    """(N,)."""

    def fields(self, frames: Sequence[Frame]) -> dict[str, Any]:
        """Fields of a `Solution`."""
        statistics: dict[str, Any] = dict(self.result.statistics)
        if len(self.keys) < len(frames):
            statistics["keyframes"] = len(self.keys)
        statistics["residual_m"] = {f.name: float(r) for f, r in zip(frames, self.residual_m, strict=True)}
        known = np.isfinite(self.result.depth_gain_sigma)
        return {
            "T_world_camera": self.T_world_camera,
            "depth_gain": self.result.depth_gain,
            "depth_gain_sigma": self.result.depth_gain_sigma if known else None,
            "pose_sigma_m": self.result.residual_m,
            "warnings": tuple(self.result.warnings),
            "statistics": statistics,
        }


def refine_all(frames: Sequence[Frame], T: F64, evidence: Evidence, **options: Any) -> Refined:
    """`refine` for any number of frames: of a dense capture keyframes are refined together, the others follow them."""
    keys, followers = choose_by_poses(evidence.views, T)
    result = refine([frames[k] for k in keys], T[keys], evidence=evidence.subset(keys), **options)
    poses, residual = T.copy(), np.full(len(T), np.nan)
    poses[keys], residual[keys] = result.T_world_camera, result.per_frame_residual_m
    if followers:
        rest = list(followers)
        starts = np.stack([poses[key] @ motion for key, motion in followers.values()])
        s = result.statistics
        position, degrees = s.get("given_position_sigma_m"), s.get("given_angle_sigma_deg")
        prior = None if position is None or degrees is None else (float(position), float(np.radians(degrees)))
        poses[rest], residual[rest] = localize([evidence.views[k] for k in rest], starts, result.landmarks, prior)
    return Refined(result, keys, poses, residual)


def refine_or_keep(
    frames: Sequence[Frame], T: F64, evidence: Evidence, *, estimate_gain: bool, sensor_sigma: float, seed: int
) -> dict[str, Any]:
    """Fields of a `Solution` from metric poses (N, 4, 4): the first proposal that is not worse than they are.

    Args:
        estimate_gain: also recover the depth sensor's gain.
        sensor_sigma: relative standard error of the sensor's own scale, before anything was seen.
    """
    said: list[str] = []
    tried: list[dict[str, Any]] = []
    for name, found in _proposals(frames, T, evidence, estimate_gain, sensor_sigma, seed, said):
        views = [evidence.views[k] for k in found.keys]
        after = (found.result.T_world_camera, found.result.depth_gain)
        judged = compare(views, found.result.held_out, (T[found.keys], 1.0), after, seed)
        tried.append({"proposal": name, **asdict(judged)})
        if not judged.grew:
            fields = found.fields(frames)
            fields["warnings"] = (*said, *warn_of_scale(fields["depth_gain"]), *fields["warnings"])
            fields["statistics"] |= {"poses": f"given, {name}", "held_out": tried}
            return fields
        said.append(
            f"the poses {name} were discarded: on {judged.pairs} pairs of frames that took no part, depth fits depth "
            f"to {1e3 * judged.after_m:.1f} mm instead of {1e3 * judged.before_m:.1f} mm with the given poses"
        )
    said.append("the given poses and the sensor's own depth are used as they are")
    return {
        "T_world_camera": T,
        "pose_sigma_m": tried[0]["before_m"] if tried and tried[0]["pairs"] else None,
        "warnings": tuple(said),
        "statistics": {"poses": "given", "held_out": tried},
    }


def warn_of_scale(gain: float) -> tuple[str, ...]:
    """Warnings if poses and depth differ in scale."""
    if abs(gain - 1) < WORTH_TELLING:
        return ()
    return (
        f"depth and poses differ in scale by {abs(1 / gain - 1):.1%}: depth was multiplied by {gain:.3f}, so that "
        "lengths are those of the poses; either of the two may be wrong, and the scale's interval is wider for it",
    )


def _proposals(
    frames: Sequence[Frame],
    T: F64,
    evidence: Evidence,
    estimate_gain: bool,
    sensor_sigma: float,
    seed: int,
    said: list[str],
) -> Iterator[tuple[str, Refined]]:
    options: dict[str, Any] = {"trust": "metric", "seed": seed, "sensor_sigma": sensor_sigma}
    found = refine_all(frames, T, evidence, estimate_gain=estimate_gain, **options)
    bare = evidence.without_color()
    gain, sigma = found.result.depth_gain, found.result.depth_gain_sigma
    alone: Refined | None = None
    if estimate_gain and abs(np.log(gain)) > UNUSUAL * sensor_sigma:
        alone = refine_all(frames, T, bare, estimate_gain=True, **options)
        other, other_sigma = alone.result.depth_gain, alone.result.depth_gain_sigma
        text = f"depth and poses differ in scale by {gain - 1:+.1%}, more than this sensor is usually off"
        if abs(gain - other) > 2 * np.hypot(sigma, other_sigma):
            said.append(f"{text}; surfaces without colour say {other - 1:+.1%}: the gain is not applied")
            found = refine_all(frames, T, evidence, estimate_gain=False, **options)
            alone = None
            estimate_gain = False
        else:
            said.append(f"{text}; surfaces without colour confirm it")
    yield "refined", found
    if evidence.has_features:
        yield "refined by surfaces alone", alone or refine_all(frames, T, bare, estimate_gain=estimate_gain, **options)
