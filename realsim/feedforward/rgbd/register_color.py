"""Frames with their colour camera corrected where matches show that it is another one than was read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from realsim.core.types import F64, Frame
from realsim.feedforward.rgbd.depth_colour_sync import check_together
from realsim.feedforward.rgbd.extrinsic_calibration import Found, calibrate, choose_nearby
from realsim.feedforward.rgbd.features import Evidence
from realsim.feedforward.rgbd.loop_closure import keep_plausible
from realsim.feedforward.rgbd.refine import refine
from realsim.feedforward.rgbd.refine_pairs import choose_pairs


@dataclass(frozen=True)
class Colour:
    """Frames as corrected so far."""

    frames: Sequence[Frame]
    evidence: Evidence
    """Of these frames."""
    tried: tuple[tuple[Found, bool], ...] = ()
    """Calibrations in their order, and whether each was applied."""

    def corrected(self, found: Found, apply: bool) -> Colour:
        """With a further calibration."""
        tried = (*self.tried, (found, apply))
        if not apply:
            return Colour(self.frames, self.evidence, tried)
        frames = [found.registration.applied(f) for f in self.frames]
        return Colour(frames, Evidence.of(frames, self.evidence.seed), tried)

    @property
    def corrections(self) -> F64:
        """(K, 5) rows of `Registration`, in their order."""
        return np.array([found.registration.row for found, applied in self.tried if applied]).reshape(-1, 5)

    @property
    def statistics(self) -> dict[str, Any]:
        """JSON-able."""
        rows = [{**found.summary(), "applied": applied} for found, applied in self.tried]
        return {"registration": rows} if rows else {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was corrected, in words."""
        if not len(self.corrections):
            return ()
        zoom, shift = float(np.prod(1 + self.corrections[:, 0])), 1e3 * self.corrections[:, 3:].sum(0)
        return (
            f"colour is not registered to depth as the capture has it: its focal length is {1 / zoom - 1:+.1%} of what "
            f"was read, and its camera {shift[0]:.0f} mm to the side; estimated from the frames and corrected",
        )


def register_color(frames: Sequence[Frame], source: Path, seed: int) -> Colour:
    """Correct the colour camera by matches alone, whatever the poses are.

    Raises:
        PoseError: colour and depth are not of one view at one time.
    """
    colour = Colour(frames, Evidence.of(frames, seed))
    check_together(colour.evidence.views, source, seed)
    for _ in range(3):  # right rays match more, which makes them righter
        found = calibrate(colour.evidence.views, colour.evidence.matches(choose_nearby(len(frames))))
        if found is None:
            break
        use = found.clear or (len(colour.corrections) > 0 and found.after < found.before)
        colour = colour.corrected(found, use)
        if not use:
            break
    return colour


def register_color_under(T: F64, colour: Colour, keep: Sequence[int], options: Mapping[str, Any]) -> Colour:
    """The same where colour turned out to be another camera and poses are given: surfaces alone refine these, and
    matches under them tell where that camera is. Features, which refine the poses next, would else pull them to where
    the colour camera is taken to be.

    Args:
        T: (N, 4, 4) given poses, of which those to `keep` are believed.
        options: of `refine`.
    """
    own, frames = colour.evidence.subset(keep), [colour.frames[k] for k in keep]
    alone = refine(frames, T[list(keep)], evidence=own.without_color(), trust="metric", **options)
    poses = alone.T_world_camera
    matches = keep_plausible(own, choose_pairs(own.views, poses), poses)
    found = calibrate(own.views, matches, poses, alone.depth_gain)
    return colour if found is None or found.after >= found.before else colour.corrected(found, True)
