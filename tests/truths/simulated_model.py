"""A stand-in for a feed-forward model: an ONNX file that knows the answer for a few given pictures.

The graph recognises a picture by the mean of its channels and emits what it was told about it. Nothing is learned and
nothing is predicted: it proves the path from a file to a scene, with answers (and errors) that are known exactly. What
a real model would say about other pictures cannot be had from it. Needs the package onnx.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realsim.core.geometry import R_to_quat, invert_T
from realsim.core.types import F64

OPSET = 20


@dataclass(frozen=True)
class Answers:
    """What the model says about V pictures, in its own unit."""

    signatures: F64
    """(V, 3) mean of each channel of the picture as the model gets it."""
    depth: F64
    """(V, H, W) along z."""
    K: F64
    """(V, 3, 3) the model's idea of the cameras, pixels of its grid."""
    T_world_camera: F64
    """(V, 4, 4)."""
    conf: F64
    """(V, H, W) 0..1."""
    metric_scale: float | None = None


@dataclass(frozen=True)
class Shape:
    """How the file says it: the variants of the contract."""

    kind: str = "pointmap"
    pose: str = "c2w"
    conf: str = "logit"
    norm: str = "identity"
    fit: str = "resize"
    patch: int = 14
    scale: str = "none"
    batched: bool = True
    """Images (1, N, 3, H, W) and outputs with a leading one; else (N, ...)."""
    channels_first: bool = False
    """Points as (..., 3, H, W), depth with a channel axis."""
    input_name: str = "images"
    n_static: int | None = None
    max_views: int | None = None
    said: bool = True
    """Whether the metadata is in the file."""
    names: Mapping[str, str] | None = None
    """Other names for outputs."""
    extra_inputs: tuple[str, ...] = ()
    shift: float = 0.0
    """Of kind mono: what is missing from z."""


DEFAULT_NAMES = {
    "pointmap": {"points": "local_points", "pose": "camera_poses", "conf": "conf"},
    "depth": {"depth": "depth", "pose": "extrinsics", "conf": "conf", "intrinsics": "intrinsics"},
    "world": {"points": "world_points", "pose": "camera_poses", "conf": "world_points_conf"},
    "pair": {"points": "pts3d", "other": "pts3d_in_other_view", "conf": "conf_1", "other_conf": "conf_2"},
    "mono": {"points": "points", "mask": "mask", "conf": "conf"},
}


def write_model(path: Path, answers: Answers, shape: Shape) -> Path:
    """Write the ONNX file (and nothing else)."""
    from onnx import TensorProto, helper, save

    graph = _Graph()
    names = {**DEFAULT_NAMES[shape.kind], **(shape.names or {})}
    _recognise(graph, answers, shape)
    outputs = {"pair": _pair, "mono": _mono}.get(shape.kind, _many)(graph, answers, shape, names)
    if answers.metric_scale is not None:
        outputs.append(graph.constant("metric_scale", np.float32([answers.metric_scale])))
    n = shape.n_static or "N"
    h, w = answers.depth.shape[1:]
    dims = [1, n, 3, h, w] if shape.batched else [n, 3, h, w]
    inputs = [helper.make_tensor_value_info(shape.input_name, TensorProto.FLOAT, dims)]
    inputs += [_extra(name) for name in shape.extra_inputs]
    declared = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs]
    body = helper.make_graph(graph.nodes, "simulated", inputs, declared, graph.initializers)
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="simulated")
    model.ir_version = 10
    if shape.said:
        keys = ("kind", "norm", "patch", "fit", "max_views", "n_static", "pose", "conf", "scale")
        said = {**{k: getattr(shape, k) for k in keys}, "fixed_hw": f"{h},{w}"}
        helper.set_model_props(model, {k: str(v) for k, v in said.items() if v is not None})
    path.parent.mkdir(parents=True, exist_ok=True)
    save(model, path)
    return path


class _Graph:
    """Nodes and constants as they are added."""

    def __init__(self) -> None:
        self.nodes: list = []
        self.initializers: list = []

    def constant(self, name: str, value: NDArray) -> str:
        from onnx import numpy_helper

        self.initializers.append(numpy_helper.from_array(np.asarray(value), f"{name}_value"))
        return self.node("Identity", [f"{name}_value"], name)

    def table(self, name: str, value: NDArray) -> str:
        from onnx import numpy_helper

        self.initializers.append(numpy_helper.from_array(np.asarray(value), f"{name}_table"))
        return f"{name}_table"

    def node(self, op: str, inputs: Sequence[str], output: str, **attributes: object) -> str:
        from onnx import helper

        self.nodes.append(helper.make_node(op, list(inputs), [output], **attributes))
        return output


def _recognise(graph: _Graph, answers: Answers, shape: Shape) -> None:
    """`id` (N,): which of the known pictures each one is, by the nearest channel means."""
    images = shape.input_name
    if shape.batched:
        images = graph.node("Squeeze", [images, graph.table("first", np.int64([0]))], "unbatched")
    mean = graph.node("ReduceMean", [images, graph.table("pixels", np.int64([2, 3]))], "mean", keepdims=0)
    column = graph.node("Unsqueeze", [mean, graph.table("second", np.int64([1]))], "mean_column")
    known = graph.table("known", answers.signatures[None].astype(np.float32))
    off = graph.node("Sub", [column, known], "off")
    square = graph.node("ReduceSumSquare", [off, graph.table("channels", np.int64([2]))], "square", keepdims=0)
    graph.node("ArgMin", [square], "id", axis=1, keepdims=0)


def _many(graph: _Graph, a: Answers, shape: Shape, names: Mapping[str, str]) -> list[str]:
    local = unprojected(a.depth, a.K)
    world = np.einsum("vab,vhwb->vhwa", a.T_world_camera[:, :3, :3], local) + a.T_world_camera[:, None, None, :3, 3]
    tables: dict[str, NDArray] = {"pose": encode_poses(a, shape.pose)}
    if shape.kind == "depth":
        tables["depth"] = a.depth[:, None] if shape.channels_first else a.depth
        if shape.pose != "pose_enc9":
            tables["intrinsics"] = a.K
    else:
        points = local if shape.kind == "pointmap" else world
        tables["points"] = points.transpose(0, 3, 1, 2) if shape.channels_first else points
    if shape.conf != "none":
        conf = encode_conf(a.conf, shape.conf)
        tables["conf"] = conf[..., None] if shape.channels_first else conf
    return [_gathered(graph, names[role], value, "id", shape.batched) for role, value in tables.items()]


def _pair(graph: _Graph, a: Answers, shape: Shape, names: Mapping[str, str]) -> list[str]:
    """Points of both pictures in the first one's camera, each run in a unit of its own."""
    one, two = graph.table("one", np.int64([0])), graph.table("two", np.int64([1]))
    first, second = graph.node("Gather", ["id", one], "first_id"), graph.node("Gather", ["id", two], "second_id")
    v, h, w = a.depth.shape
    local = unprojected(a.depth, a.K)
    world = np.einsum("vab,vhwb->vhwa", a.T_world_camera[:, :3, :3], local) + a.T_world_camera[:, None, None, :3, 3]
    back = invert_T(a.T_world_camera)
    table = graph.table("unit", np.linspace(0.7, 1.3, v).astype(np.float32).reshape(v, 1, 1, 1))
    unit = graph.node("Gather", [table, second], "run_unit")
    own = graph.node("Gather", [graph.table("local", local.astype(np.float32)), first], "own")
    flat = graph.node(
        "Gather", [graph.table("world", world.reshape(v, h * w, 3).astype(np.float32)), second], "flat_world"
    )
    R = graph.node("Gather", [graph.table("R", back[:, :3, :3].transpose(0, 2, 1).astype(np.float32)), first], "back_R")
    t = graph.node("Gather", [graph.table("t", back[:, None, :3, 3].astype(np.float32)), first], "back_t")
    turned = graph.node("Add", [graph.node("MatMul", [flat, R], "turned"), t], "other_flat")
    other = graph.node("Reshape", [turned, graph.table("hw3", np.int64([1, h, w, 3]))], "other_map")
    conf = graph.table("conf", encode_conf(a.conf, shape.conf).astype(np.float32))
    return [
        graph.node("Mul", [own, unit], names["points"]),
        graph.node("Mul", [other, unit], names["other"]),
        graph.node("Gather", [conf, first], names["conf"]),
        graph.node("Gather", [conf, second], names["other_conf"]),
    ]


def _mono(graph: _Graph, a: Answers, shape: Shape, names: Mapping[str, str]) -> list[str]:
    local = unprojected(a.depth, a.K)
    # Every view in a unit of its own, as single views are.
    unit = np.linspace(0.8, 1.2, len(local))[:, None, None, None]
    local = local * unit - np.array([0, 0, shape.shift])
    mask = (a.conf > 0).astype(np.float32)
    out = [_gathered(graph, names["points"], local, "id", False), _gathered(graph, names["mask"], mask, "id", False)]
    if shape.conf != "none":
        out.append(_gathered(graph, names["conf"], encode_conf(a.conf, shape.conf), "id", False))
    return out


def _gathered(graph: _Graph, name: str, table: NDArray, index: str, batched: bool) -> str:
    rows = graph.node(
        "Gather", [graph.table(name, table.astype(np.float32)), index], f"{name}_rows" if batched else name
    )
    return graph.node("Unsqueeze", [rows, graph.table(f"{name}_axis", np.int64([0]))], name) if batched else rows


def _extra(name: str) -> object:
    from onnx import TensorProto, helper

    shapes = {
        "depths": [1, "N", "H", "W"], "intrinsics": [1, "N", 3, 3], "poses": [1, "N", 4, 4], "num_tokens": [],
    }  # fmt: skip
    kind = TensorProto.INT64 if name == "num_tokens" else TensorProto.FLOAT
    return helper.make_tensor_value_info(name, kind, shapes[name])


def unprojected(depth: F64, K: F64) -> F64:
    """(V, H, W, 3) points of depth (V, H, W) by cameras (V, 3, 3)."""
    v, u = np.indices(depth.shape[1:]).astype(float)
    pixels = np.stack([u, v, np.ones_like(u)], -1)
    return np.einsum("nab,hwb->nhwa", np.linalg.inv(K), pixels) * depth[..., None]


def encode_poses(a: Answers, how: str) -> F64:
    """Camera-to-world poses (V, 4, 4) as a model writes them."""
    T = a.T_world_camera
    if how == "c2w":
        return T
    if how == "w2c":
        return invert_T(T)[:, :3]
    if how == "raw9":  # rows of any length: only the directions count
        return np.concatenate([1.7 * T[:, :3, :3].reshape(-1, 9), T[:, :3, 3]], 1)
    h, w = a.depth.shape[1:]
    back = invert_T(T)
    quat = np.stack([R_to_quat(M[:3, :3])[[1, 2, 3, 0]] for M in back])
    fov = np.stack([2 * np.arctan(h / 2 / a.K[:, 1, 1]), 2 * np.arctan(w / 2 / a.K[:, 0, 0])], 1)
    return np.concatenate([back[:, :3, 3], quat, fov], 1)


def encode_conf(conf: F64, how: str) -> F64:
    """Confidence 0..1 as a model writes it."""
    c = np.clip(conf, 1e-4, 1 - 1e-4)
    return {"logit": np.log(c / (1 - c)), "exp1": 1 / (1 - c), "log_error": np.log((1 - c) / c), "none": c}[how]
