"""Points in every camera's own frame, and its pose (Pi3, MapAnything)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

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
    posed,
    read_poses,
)


def unpack(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Where the model has a second head for world points, how far the two disagree is told, and nothing else."""
    points = as_maps("local_points", found["local_points"], call, 3)
    T = read_poses(found["pose"], call)
    prediction = posed(points, T, found, call)
    if "world_points" not in found or not prediction.mask.any():
        return prediction
    world = as_maps("world_points", found["world_points"], call, 3)
    own = np.einsum("nab,nhwb->nhwa", T[:, :3, :3], points) + T[:, None, None, :3, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.linalg.norm(world - own, axis=-1) / points[..., 2]
    figures = {**prediction.figures, "heads_disagree": float(np.nanmedian(off[prediction.mask]))}
    return replace(prediction, figures=figures)


ADAPTER = Adapter(
    needs={"local_points": ("local_points", "pts3d_cam", "points_cam"), "pose": POSE_NAMES},
    takes={"conf": CONF_NAMES, "world_points": ("points", "pts3d", "world_points"), **MASK},
    unpack=unpack,
)
