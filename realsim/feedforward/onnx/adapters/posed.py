"""Models of several views: points in each camera (Pi3, MapAnything), depth (Depth Anything 3, VGGT's depth head),
points in one world (VGGT's point head); and of two, both in the first camera's frame (DUSt3R, MASt3R)."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import invert_T
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
    read_claim,
    read_conf,
    read_mask,
    read_poses,
    unproject,
)


def from_pointmap(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Where the model has a second head for world points, only how far the two disagree is reported."""
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


def from_depth(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Depth goes along the rays of the model's own camera: its poses belong to that one. Without one, the capture's."""
    depth = as_maps("depth", found["depth"], call, 1)
    if "intrinsics" in found:
        K = as_rows("intrinsics", found["intrinsics"], call, (3, 3))
    elif call.pose == "pose_enc9":
        K = encoded_intrinsics(as_rows("pose", found["pose"], call, (9,)), call)
    else:
        K = call.intrinsics
    return posed(unproject(depth, K), read_poses(found["pose"], call), found, call)


def from_world(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """World points, taken back into their cameras."""
    world = as_maps("world_points", found["world_points"], call, 3)
    T = read_poses(found["pose"], call)
    back = invert_T(T)
    points = (np.einsum("nab,nhwb->nhwa", back[:, :3, :3], world) + back[:, None, None, :3, 3]).astype(np.float32)
    return posed(points, T, found, call)


def from_pair(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Two views whose "local" points are both in the first camera's frame; poses are the identity by definition, and
    `onnx.place.place_pairs` joins the pairs."""
    one = replace(call, n=1, ran=1)
    points = np.concatenate([as_maps(r, found[r], one, 3) for r in ("points", "other_points")])
    conf = np.concatenate([read_conf(found, one, r) for r in ("conf", "other_conf")])
    # Seen from the first camera, what the second one sees may well lie behind.
    finite = np.isfinite(points).all(-1)
    mask = np.stack([read_mask({}, one, points[:1])[0], finite[1]])
    return Prediction(points, np.tile(np.eye(4), (2, 1, 1)), conf, mask, read_claim(found))


POINTMAP = Adapter(
    needs={"local_points": ("local_points", "pts3d_cam", "points_cam"), "pose": POSE_NAMES},
    takes={"conf": CONF_NAMES, "world_points": ("points", "pts3d", "world_points"), **MASK},
    unpack=from_pointmap,
)
DEPTH = Adapter(
    needs={"depth": ("depth", "depth_z", "pred_depth"), "pose": POSE_NAMES},
    takes={"conf": ("depth_conf", *CONF_NAMES), "intrinsics": ("intrinsics", "intrinsic"), **MASK},
    unpack=from_depth,
)
WORLD = Adapter(
    needs={"world_points": ("world_points", "points", "pts3d"), "pose": POSE_NAMES},
    takes={"conf": ("world_points_conf", *CONF_NAMES), **MASK},
    unpack=from_world,
)
PAIR = Adapter(
    needs={
        "points": ("pts3d", "pts3d_1", "points"),
        "other_points": ("pts3d_in_other_view", "pts3d_2"),
    },
    takes={
        "conf": ("conf", "conf_1", "conf1"),
        "other_conf": ("conf_in_other_view", "conf_2", "conf2"),
        "metric_scale": ("metric_scale",),
    },
    unpack=from_pair,
)
