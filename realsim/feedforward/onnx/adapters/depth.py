"""Depth, camera and pose of every view (Depth Anything 3, VGGT's depth head)."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from realsim.feedforward.onnx.adapters.base import (
    CONF_NAMES,
    MASK,
    POSE_NAMES,
    Adapter,
    Call,
    Prediction,
    as_maps,
    as_rows,
    encoded_intrinsics,
    posed,
    read_poses,
    unproject,
)


def unpack(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Depth goes along the rays of the model's own camera: its poses belong to that one. Without one, the capture's."""
    depth = as_maps("depth", found["depth"], call, 1)
    if "intrinsics" in found:
        K = as_rows("intrinsics", found["intrinsics"], call, (3, 3))
    elif call.pose == "pose_enc9":
        K = encoded_intrinsics(as_rows("pose", found["pose"], call, (9,)), call)
    else:
        K = call.intrinsics
    return posed(unproject(depth, K), read_poses(found["pose"], call), found, call)


ADAPTER = Adapter(
    needs={"depth": ("depth", "depth_z", "pred_depth"), "pose": POSE_NAMES},
    takes={"conf": ("depth_conf", *CONF_NAMES), "intrinsics": ("intrinsics", "intrinsic"), **MASK},
    unpack=unpack,
)
