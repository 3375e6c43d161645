"""Points of all views in one world, and the poses (VGGT's point head)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from realsim.feedforward.onnx.adapters.base import (
    CONF_NAMES,
    MASK,
    POSE_NAMES,
    Adapter,
    Call,
    Prediction,
    as_maps,
    invert,
    posed,
    read_poses,
)


def unpack(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """World points, taken back into their cameras."""
    world = as_maps("world_points", found["world_points"], call, 3)
    T = read_poses(found["pose"], call)
    back = invert(T)
    points = (np.einsum("nab,nhwb->nhwa", back[:, :3, :3], world) + back[:, None, None, :3, 3]).astype(np.float32)
    return posed(points, T, found, call)


ADAPTER = Adapter(
    needs={"world_points": ("world_points", "points", "pts3d"), "pose": POSE_NAMES},
    takes={"conf": ("world_points_conf", *CONF_NAMES), **MASK},
    unpack=unpack,
)
