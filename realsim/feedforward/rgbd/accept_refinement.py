"""Given poses are a baseline: what is delivered is the first proposal that held-out pairs do not find worse.

The proposals, in this order: poses refined with the sensor's gain; the same without a gain, where the gain is more than
the sensor can be off and the surfaces alone do not confirm it; poses refined by surfaces alone; the poses as given.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from realsim.core.types import F64, Frame
from realsim.feedforward.rgbd.features import Evidence
from realsim.feedforward.rgbd.heldout import compare
from realsim.feedforward.rgbd.refine import RefineResult, refine

WORTH_TELLING = 0.02
"""Relative difference between the scale of poses and depth from which a warning is given."""
UNUSUAL = 3.0
"""Standard deviations of the sensor's own scale beyond which surfaces without colour must confirm a gain."""


def refine_or_keep(
    frames: Sequence[Frame], T: F64, evidence: Evidence, *, estimate_gain: bool, sensor_sigma: float, seed: int
) -> dict[str, Any]:
    """Fields of a `Solution` from metric poses (N, 4, 4): the first proposal that is not worse than they are.

    Args:
        estimate_gain: also recover the depth sensor's gain.
        sensor_sigma: relative standard error of the sensor's own scale, before anything was seen.
    """
    notes: list[str] = []
    tried: list[dict[str, Any]] = []
    for name, found in _proposals(frames, T, evidence, estimate_gain, sensor_sigma, seed, notes):
        after = (found.T_world_camera, found.depth_gain)
        judged = compare(evidence.views, found.held_out, (T, 1.0), after, seed)
        tried.append({"proposal": name, **asdict(judged)})
        if not judged.grew:
            fields = found.fields(frames)
            fields["warnings"] = (*notes, *warn_of_scale(fields["depth_gain"]), *fields["warnings"])
            fields["statistics"] |= {"poses": f"given, {name}", "held_out": tried}
            return fields
        notes.append(
            f"the poses {name} were discarded: on {judged.pairs} pairs of frames that took no part, depth fits depth "
            f"to {1e3 * judged.after_m:.1f} mm instead of {1e3 * judged.before_m:.1f} mm with the given poses"
        )
    notes.append("the given poses and the sensor's own depth are used as they are")
    return {
        "T_world_camera": T,
        "pose_sigma_m": tried[0]["before_m"] if tried and tried[0]["pairs"] else None,
        "warnings": tuple(notes),
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
    notes: list[str],
) -> Iterator[tuple[str, RefineResult]]:
    options: dict[str, Any] = {"trust": "metric", "seed": seed, "sensor_sigma": sensor_sigma}
    found = refine(frames, T, evidence=evidence, estimate_gain=estimate_gain, **options)
    bare = evidence.without_color()
    alone: RefineResult | None = None
    if estimate_gain and abs(np.log(found.depth_gain)) > UNUSUAL * sensor_sigma:
        alone = refine(frames, T, evidence=bare, estimate_gain=True, **options)
        text = f"depth and poses differ in scale by {found.depth_gain - 1:+.1%}, more than this sensor is usually off"
        text += " (so does a wrong focal length)"
        other = f"surfaces without colour say {alone.depth_gain - 1:+.1%}"
        sigma = np.hypot(found.depth_gain_sigma, alone.depth_gain_sigma)
        if abs(found.depth_gain - alone.depth_gain) > 2 * sigma:
            notes.append(f"{text}; {other}, beyond both errors: the gain is not applied")
            estimate_gain, alone = False, None
            found = refine(frames, T, evidence=evidence, estimate_gain=False, **options)
        else:
            notes.append(f"{text}; surfaces without colour confirm it")
    yield "refined", found
    if evidence.has_features:
        alone = alone or refine(frames, T, evidence=bare, estimate_gain=estimate_gain, **options)
        yield "refined by surfaces alone", alone
