"""Steps for every capture after its layout has read it: examine each frame once, keep the usable ones."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from realsim.capture.alignment import put_right
from realsim.capture.config import CaptureConfig
from realsim.capture.consistency import GOOD, Agreement, check_agreement
from realsim.capture.intrinsics import OFF_CENTRE, off_centre
from realsim.capture.poses import PoseReport, settle_poses
from realsim.capture.selection import pick
from realsim.capture.survey import Look, blurred, duplicates, smeared, survey
from realsim.capture.units import check_height, check_unit
from realsim.core.errors import CaptureError
from realsim.core.types import F32, Dropped, Frame, FrameSet

LEAST_COVERAGE = 0.01
"""Share of pixels with depth in range below which a frame says nothing."""


@dataclass(frozen=True)
class Finished:
    """A capture that is ready for the pipeline, with what was seen on the way."""

    capture: FrameSet
    looks: tuple[Look, ...]
    """One a frame of `capture`."""
    poses: PoseReport
    agreement: Agreement | None
    """Of poses and depth; None where it could not be determined."""
    seen: int
    """Frames in the capture before anything was left out."""


@dataclass(frozen=True)
class InRange:
    """A depth reader whose values outside [near, far] metres are 0."""

    read: Callable[[], F32]
    near: float
    far: float

    def __call__(self) -> F32:
        depth = self.read()
        # Written so that NaN fails the comparison and becomes 0 as well.
        return np.where((depth >= self.near) & (depth <= self.far), depth, np.float32(0)).astype(np.float32, copy=False)


ODD_CAMERA = 0.05
"""Of the focal length, or of the image's size for the principal point. Focusing moves a phone's by at most 0.3 percent
(24 frames of a real iPhone capture)."""


def finish(raw: FrameSet, config: CaptureConfig) -> Finished:
    """Poses made rigid, damaged, empty, blurred and repeated frames dropped, too many thinned out, range limited.

    Raises:
        CaptureError: no frame is left, or the depth unit is implausible.
        PoseError: none of the given poses can be used, or they are of another convention.
    """
    seen = len(raw.frames) + len(raw.dropped)
    metric = raw.poses_metric and config.metric_poses
    capture = replace(raw, frames=raw.frames[:: config.every], poses_metric=metric)
    if config.every > 1:
        capture = replace(capture, assumptions=(*capture.assumptions, f"only every {config.every}. frame is used"))
    capture, poses = settle_poses(capture, config.max_depth)
    looks, damaged = survey(capture.frames, config)
    capture, looks = _without(capture, looks, damaged)
    _some_left(capture)

    unit_note = check_unit(capture.frames, looks, capture.source)
    reason = f"valid depth between {config.min_depth:g} and {config.max_depth:g} m"
    hollow = [look for look in looks if look.valid_share < LEAST_COVERAGE]
    empty = [Dropped(look.name, f"{'hardly any' if look.valid_share else 'no'} {reason}") for look in hollow]
    capture, looks = _without(capture, looks, empty)
    _some_left(capture)
    capture, looks = _without(capture, looks, duplicates(looks))
    if not config.keep_blurred:
        capture, looks = _without(capture, looks, blurred(looks))
    capture, looks = _without(capture, looks, pick(capture.frames, looks, config.max_frames))
    capture = put_right(capture)
    doubts: list[str | None] = []
    odd = _odd_cameras(capture.frames)
    if odd:
        note = f"{len(odd)} of {len(capture.frames)} frames have a camera unlike all others' ({', '.join(odd[:3])})"
        doubts.append(f"{note}: are their intrinsics damaged?")
    aside = [
        c for f in capture.frames for c in {f.intrinsics, f.color_intrinsics} if c and off_centre(c) > OFF_CENTRE[0]
    ]
    if aside:
        c = aside[0]
        note = f"the principal point ({c.cx:.0f}, {c.cy:.0f}) is far from the middle of {c.width}x{c.height} pixels"
        doubts.append(f"{note}: are the intrinsics of another resolution?")
    stamped = [(f.timestamp, f.name) for f in capture.frames if f.timestamp is not None]
    late = [f"{b}, {t1:.3f} s after {t0:.3f} s" for (t0, _), (t1, b) in pairwise(stamped) if t1 <= t0]
    if late:
        note = f"{len(late)} of {len(stamped)} time stamps do not increase ({late[0]})"
        doubts.append(f"{note}: are the stamps or the order damaged?")
    without = [f.name for f in capture.frames if f.read_confidence is None]
    if 0 < len(without) < len(capture.frames):
        note = f"{len(without)} of {len(capture.frames)} frames have no confidence: all of their depth is believed"
        doubts.append(f"{note} ({', '.join(without[:3])})")
    agreement, pose_note = check_agreement(capture)
    # Metric poses that agree with the depth have confirmed its unit.
    confirmed = agreement is not None and capture.poses_metric and agreement.as_read >= GOOD
    limits = (config.min_depth, config.max_depth)
    units = () if confirmed else (unit_note, check_height(capture.frames))
    doubts += [*units, pose_note, smeared(looks)]
    capture = replace(
        capture,
        frames=_files_named_once([replace(f, read_depth=InRange(f.read_depth, *limits)) for f in capture.frames]),
        warnings=(*capture.warnings, *filter(None, doubts)),
    )
    return Finished(capture, tuple(looks), poses, agreement, seen)


def _odd_cameras(frames: Sequence[Frame]) -> list[str]:
    """Names of the frames whose intrinsics are off the median of all frames of their size by more than ODD_CAMERA."""
    cameras = [f.intrinsics for f in frames]
    values = np.array([[c.fx / c.width, c.fy / c.height, c.cx / c.width, c.cy / c.height] for c in cameras])
    middle = np.median(values, axis=0)
    off = np.abs(values - middle) / np.array([*middle[:2], 1.0, 1.0])
    return [f.name for f, row in zip(frames, off, strict=True) if row.max() > ODD_CAMERA]


def _without(capture: FrameSet, looks: Sequence[Look], dropped: Sequence[Dropped]) -> tuple[FrameSet, list[Look]]:
    names = {d.name for d in dropped}
    frames = tuple(f for f in capture.frames if f.name not in names)
    kept = replace(capture, frames=frames, dropped=(*capture.dropped, *dropped))
    return kept, [look for look in looks if look.name not in names]


def _some_left(capture: FrameSet) -> None:
    if capture.frames:
        return
    reasons = Counter(d.reason for d in capture.dropped).most_common(3)
    raise CaptureError(
        "no frame of this capture can be used",
        file=capture.source,
        found="; ".join(f"{count} x {reason}" for reason, count in reasons),
    )


def _files_named_once(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """A video or an archive that many frames are read from is named by the first of them alone: together the frames
    still name all that they are read from, and whoever digests it reads each file once.
    """
    seen: set[Path] = set()
    out = []
    for frame in frames:
        out.append(replace(frame, files=tuple(f for f in frame.files if f not in seen)))
        seen.update(frame.files)
    return tuple(out)
