"""Frames to pointmaps and poses, up to scale. One backend is one module (or package) and one line here."""

from __future__ import annotations

from realsim.errors import CaptureError
from realsim.feedforward.config import PointsConfig
from realsim.registry import Registry
from realsim.types import FrameSet, Pointmaps, Solution

BACKENDS = Registry(
    "backend",
    {
        "rgbd": "realsim.feedforward.rgbd:BACKEND",
        "colmap": "realsim.feedforward.colmap:BACKEND",
    },
)


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses of the frames that fit together, by the backend that `config` names.

    Raises:
        UnknownNameError: no such backend.
        CaptureError: no frames.
        PoseError: poses are asked for and not there, contradict the depth, or cannot be estimated.
    """
    backend = BACKENDS[config.backend]
    if not frames.frames:
        raise CaptureError("no frames", file=frames.source, expected="at least one frame", found="none")
    return backend.solve(frames, config)


def pointmaps(frames: FrameSet, solution: Solution, config: PointsConfig) -> Pointmaps:
    """The views of a solution, made when they are asked for. `solution` must be of the same frames and backend."""
    return BACKENDS[config.backend].pointmaps(frames, solution, config)


__all__ = ["BACKENDS", "pointmaps", "solve"]
