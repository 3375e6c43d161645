"""A model's depth as points on a frame's own depth grid."""

from collections.abc import Mapping

import numpy as np

from realsim.core.types import F32, U8, Bool, Frame, PointView
from realsim.feedforward.onnx.preprocess import Grid, grid_to_depth
from realsim.feedforward.onnx.runner import Views
from realsim.feedforward.rgbd.views import resample


def pack(views: Views) -> dict[str, np.ndarray]:
    """Plain arrays from which a view can be made again without the model."""
    grid = [(g.width, g.height, g.sx, g.sy, g.ox, g.oy) for g in views.grids]
    return {
        "depth": views.depth,
        "conf": np.round(255 * views.conf).astype(np.uint8),
        "grid": np.array(grid, float),
    }


def predicted_depth(frame: Frame, arrays: Mapping[str, np.ndarray], i: int) -> tuple[F32, F32, Bool]:
    """Depth, confidence and mask (H, W) of view i on the frame's depth grid, in the model's unit.

    Inverse depth is what is interpolated: it is linear on planes, so planes stay planes.
    """
    w, h, sx, sy, ox, oy = arrays["grid"][i].tolist()
    grid = Grid(int(w), int(h), sx, sy, ox, oy, frame.color_intrinsics or frame.intrinsics)
    z = arrays["depth"][i]
    q = np.divide(1, z, out=np.zeros_like(z), where=z > 0)
    inverse, mask = grid_to_depth(q, z > 0, grid, frame.intrinsics)
    conf, _ = grid_to_depth(arrays["conf"][i] / np.float32(255), z > 0, grid, frame.intrinsics)
    mask = mask & (inverse > 0)
    return np.divide(1, inverse, out=np.zeros_like(inverse), where=mask), np.where(mask, conf, 0), mask


def predicted_view(frame: Frame, arrays: Mapping[str, np.ndarray], i: int) -> PointView:
    """Points up to scale. Rays are the capture's: its focal length is calibrated, the model's is a guess."""
    z, conf, mask = predicted_depth(frame, arrays, i)
    points = frame.intrinsics.rays() * z[..., None]
    return PointView(points, conf.astype(np.float32), mask, colors(frame))


def colors(frame: Frame) -> U8 | None:
    """(H, W, 3) the frame's colour on its depth grid, or None."""
    color = frame.color()
    return None if color is None else resample(color, frame.color_intrinsics or frame.intrinsics, frame.intrinsics)
