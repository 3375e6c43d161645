"""Models whose right answers are the ray-cast room, and what a run of them must give."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rooms

from realsim import feedforward
from realsim.core.geometry import invert_T
from realsim.core.types import Frame, FrameSet, Intrinsics, Pointmaps
from realsim.feedforward.config import OnnxConfig, PointsConfig
from realsim.feedforward.onnx.preprocess import make_grid, to_tensor
from realsim.feedforward.onnx.spec import Port, Spec
from tests.truths.simulated_model import Answers, Shape

CAMERA = Intrinsics(112, 84, 100.0, 101.0, 54.0, 43.0)
UNIT = 0.4
"""The models' metres per unit: a true scale of 1 / UNIT."""


def room_frame(k: int, T: np.ndarray, camera: Intrinsics = CAMERA) -> Frame:
    depth, rgb = rooms.ray_cast(T, camera)
    depth = depth.astype(np.float32)
    return Frame(f"{k:03d}", camera, lambda: depth, lambda: rgb)


def answers(frames: Sequence[Frame], poses: np.ndarray, shape: Shape, **changes: object) -> Answers:
    """The truth of frames in the model's unit, on the grid that the runner will use."""
    port = Port("images", (1, "N", 3, "H", "W"), "")
    spec = Spec("pointmap", port, {}, patch=shape.patch, fit=shape.fit)  # fmt: skip
    grids = [make_grid(f.intrinsics, spec) for f in frames]
    pictures = [to_tensor(f.color(), g, shape.norm) for f, g in zip(frames, grids, strict=True)]
    T = poses.copy()
    T[:, :3, 3] *= UNIT
    depth = np.stack([rooms.ray_cast(P, g.camera)[0] for P, g in zip(poses, grids, strict=True)])
    conf = np.where(depth > 0, 0.9, 0.0)
    values = {
        "signatures": np.stack([p.mean((1, 2)) for p in pictures]),
        "depth": UNIT * np.where(depth > 0, depth, 8.0),
        "K": np.stack([g.camera.K for g in grids]),
        "T_world_camera": T,
        "conf": conf,
    }
    return Answers(**{**values, **changes})


def run(frames: Sequence[Frame], model: Path, backend: str = "onnx", **options: object) -> Pointmaps:
    config = PointsConfig(backend=backend, onnx=OnnxConfig(model=model, drop_least_sure=0, **options))
    capture = FrameSet(tuple(frames), Path("room"), "test")
    return feedforward.pointmaps(capture, feedforward.solve(capture, config), config)


def check(maps: Pointmaps, frames: Sequence[Frame], poses: np.ndarray, unit: float = UNIT, tol: float = 2e-3) -> None:
    """Poses and points are the truth up to one similarity, whose scale is `unit`."""
    assert len(maps) == len(poses)
    expected = invert_T(poses[0]) @ poses
    np.testing.assert_allclose(maps.T_world_camera[:, :3, :3], expected[:, :3, :3], atol=tol)
    np.testing.assert_allclose(maps.T_world_camera[:, :3, 3] / unit, expected[:, :3, 3], atol=2 * tol)
    for k, frame in enumerate(frames):
        view = maps.load(k)
        true = frame.intrinsics.rays() * frame.depth()[..., None]
        off = np.linalg.norm(view.points / unit - true, axis=-1)[view.mask & (frame.depth() > 0)]
        assert view.mask.mean() > 0.5
        assert np.median(off) < tol
        assert np.quantile(off, 0.9) < 0.02
