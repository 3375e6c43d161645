"""Frames to pointmaps and poses, up to scale. One backend is one module (or package) and one line here."""

from pathlib import Path

from realsim.core.errors import CaptureError
from realsim.core.registry import Registry
from realsim.core.types import FrameSet, Pointmaps, Solution
from realsim.feedforward.backend import Kept
from realsim.feedforward.config import PointsConfig

BACKENDS = Registry(
    "backend",
    {
        "rgbd": "realsim.feedforward.rgbd:BACKEND",
        "colmap": "realsim.feedforward.colmap:BACKEND",
        "onnx": "realsim.feedforward.onnx:BACKEND",
        "onnx+depth": "realsim.feedforward.onnx.with_depth:BACKEND",
    },
)


def solve(frames: FrameSet, config: PointsConfig) -> Solution:
    """Poses of the frames that fit together, by the backend that `config` names.

    Raises:
        UnknownNameError: no such backend.
        CaptureError: no frames.
        PoseError: poses are requested and not there, contradict the depth, or cannot be estimated.
    """
    backend = BACKENDS[config.backend]
    if not frames.frames:
        raise CaptureError("no frames", file=frames.source, expected="at least one frame", found="none")
    return backend.solve(frames, config)


def pointmaps(frames: FrameSet, solution: Solution, config: PointsConfig) -> Pointmaps:
    """The views of a solution, made when they are requested and kept if few.

    `solution` must be of the same frames and backend.
    """
    used, load = BACKENDS[config.backend].load_views(tuple(frames.frames[i] for i in solution.used), solution)
    return Pointmaps(
        frames=used,
        T_world_camera=solution.T_world_camera,
        load=Kept(load, len(used)),
        backend=config.backend,
        world_is_capture=solution.world_is_capture,
        metric_claim=solution.metric_claim,
        depth_gain=solution.depth_gain,
        depth_gain_sigma=solution.depth_gain_sigma,
        pose_sigma_m=solution.pose_sigma_m,
        dropped=solution.dropped,
        warnings=solution.warnings,
        statistics=solution.statistics,
    )


def inputs(config: PointsConfig) -> tuple[Path, ...]:
    """Files besides the capture that a solution depends on; their content identifies it together with the frames."""
    return BACKENDS[config.backend].inputs(config)


__all__ = ["BACKENDS", "inputs", "pointmaps", "solve"]
