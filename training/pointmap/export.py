"""The trained network as one ONNX file for `--backend onnx` and `onnx+depth` (docs/models.md).

    python -m training.pointmap.export run --out pointmap.onnx --precision float16

The graph takes pictures, sensor depth (zeros where there is none) and intrinsics; its size is fixed, the number of
views free. Half precision and int8 are how weights are stored; onnxruntime computes in float32, which is faster on a
CPU. What storing costs is printed, and measured by `evaluate`.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from realsim.core.errors import ModelError, RealsimError
from realsim.core.files import write_bytes
from tools.export_onnx.common import ExportFailed, Family, Options, export
from training.pointmap import shipped, state
from training.pointmap.layouts import library
from training.pointmap.network import PATCH, PointmapNet
from training.pointmap.scenes import Generator
from training.pointmap.train import WITHHELD

PRECISIONS = ("float32", "float16", "int8")
MAX_VIEWS = 8
"""As many as it is trained on."""
SMALLEST = 4096
"""Numbers: smaller tensors (norms, biases) stay as they are."""
LIMIT_MB = 25.0
"""Of the file that ships."""
TOLERANCE = 2e-3
"""Difference of torch and onnxruntime over an output's spread: the largest with depth, the median without."""
OUTPUTS = ("local_points", "camera_poses", "conf")


class Exported(nn.Module):
    """The network with the contract's inputs and outputs."""

    def __init__(self, net: PointmapNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: Tensor, depths: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(1, N, H, W, 3), (1, N, 4, 4) camera to world, and (1, N, H, W) the logarithm of the expected error."""
        out = self.net(images, depths, intrinsics)
        top = torch.cat([out.R, out.t[..., None]], -1)
        bottom = (top[..., :1, :] * 0) + top.new_tensor([0.0, 0.0, 0.0, 1.0])
        return out.points(), torch.cat([top, bottom], -2), out.log_error


@dataclass(frozen=True)
class Stored:
    """A written file."""

    path: Path
    megabytes: float
    off: dict[str, float]
    """Output -> largest relative difference from torch, of the output's own spread."""


def write(now: state.State, out: Path, size: tuple[int, int], precision: str = "float32") -> Stored:
    """Export the state's network, compare with torch, store the weights in `precision`.

    Raises:
        RealsimError: no such precision or size, or a graph that says something else than torch.
    """
    if precision not in PRECISIONS:
        raise RealsimError("no such precision", expected=", ".join(PRECISIONS), found=precision)
    if size[0] % PATCH or size[1] % PATCH:
        raise RealsimError("that size cannot be cut into patches", expected=f"multiples of {PATCH}", found=str(size))
    metadata = {
        "kind": "pointmap", "norm": "identity", "patch": str(PATCH), "fit": "resize", "pose": "c2w",
        "fixed_hw": f"{size[0]},{size[1]}", "max_views": str(MAX_VIEWS), "conf": "log_error", "scale": "none",
        "family": "realsim-pointmap",
    }  # fmt: skip
    free = {name: {1: "views"} for name in ("images", "depths", "intrinsics", *OUTPUTS)}
    family = Family(Exported(now.net.cpu().eval()), OUTPUTS, metadata, free, extra=_others, exporter="torchscript")
    options = Options("", out, size=size, views=3, tolerance=TOLERANCE)
    try:
        off = export(family, options)
    except ExportFailed as error:
        raise ModelError("the network cannot be exported", file=out, found=str(error)) from error
    shipped.describe(out, now)
    feeds = _views(size)
    with torch.no_grad():
        told = [v.numpy() for v in family.module(*feeds.values())]
    plain = _outputs(out, feeds)
    if wrong := {n: v for n, v in _difference(told, plain).items() if not v <= TOLERANCE}:
        raise ModelError("torch and onnxruntime disagree by colour alone", file=out, found=str(wrong))
    if precision != "float32":
        _store(out, precision)
        off = _difference(plain, _outputs(out, feeds))
    return Stored(out, out.stat().st_size / 1e6, off)


def _others(images: Tensor) -> dict[str, Tensor]:
    """Sensor depth with holes and intrinsics for sample pictures (1, N, 3, H, W)."""
    _, n, _, h, w = images.shape
    depths = torch.where(images[:, :, 0] > 0.3, 1 + 2 * images[:, :, 1], 0.0)
    K = torch.tensor([[0.96 * w, 0, (w - 1) / 2], [0, 0.96 * w, (h - 1) / 2], [0, 0, 1]])
    return {"depths": depths, "intrinsics": K.expand(1, n, 3, 3).contiguous()}


def _views(size: tuple[int, int]) -> dict[str, Tensor]:
    """Four views of a scene, without depth. Sample pictures share nothing: what they are adjusted to is chance."""
    made = Generator(library(1, WITHHELD, ("clutter",)), WITHHELD, samples=1).batch(0, 1, 4, size)
    return {"images": made.images, "depths": torch.zeros_like(made.depth), "intrinsics": made.K}


def _outputs(path: Path, feeds: dict[str, Tensor]) -> list[np.ndarray]:
    import onnxruntime

    options = onnxruntime.SessionOptions()  # the graph as it is: to make it faster takes longer than to run it
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    return [np.asarray(v) for v in session.run(list(OUTPUTS), {k: v.numpy() for k, v in feeds.items()})]


def _difference(a: list[np.ndarray], b: list[np.ndarray]) -> dict[str, float]:
    """Output -> median absolute difference over its spread."""
    spread = [float(np.abs(x - np.median(x)).mean()) or 1.0 for x in a]
    return {n: float(np.median(np.abs(x - y))) / s for n, x, y, s in zip(OUTPUTS, a, b, spread, strict=True)}


def _store(path: Path, precision: str) -> None:
    """Replace large weights by smaller ones that the graph turns back: a cast, or int8 with a scale a row."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load(str(path))
    graph = model.graph
    added: list[Any] = []
    for tensor in list(graph.initializer):
        values = numpy_helper.to_array(tensor)
        if values.dtype != np.float32 or values.size < SMALLEST:
            continue
        graph.initializer.remove(tensor)
        small = f"{tensor.name}_stored"
        if precision == "float16":
            graph.initializer.append(numpy_helper.from_array(values.astype(np.float16), small))
            added.append(onnx.helper.make_node("Cast", [small], [tensor.name], to=onnx.TensorProto.FLOAT))
            continue
        # A scale for each output channel: first of a convolution's axes, last of a matrix that tokens multiply.
        axis = 0 if values.ndim == 4 else values.ndim - 1
        others = tuple(k for k in range(values.ndim) if k != axis)
        scale = np.maximum(np.abs(values).max(others), 1e-12).astype(np.float32) / 127
        shape = [-1 if k == axis else 1 for k in range(values.ndim)]
        whole = np.clip(np.round(values / scale.reshape(shape)), -127, 127).astype(np.int8)
        graph.initializer.append(numpy_helper.from_array(whole, small))
        graph.initializer.append(numpy_helper.from_array(scale, f"{small}_scale"))
        added.append(
            onnx.helper.make_node("DequantizeLinear", [small, f"{small}_scale"], [tensor.name], axis=axis)
        )  # fmt: skip
    nodes = [*added, *graph.node]
    for node in nodes:
        del node.metadata_props[:]
        node.doc_string = ""
    del graph.node[:]
    graph.node.extend(nodes)
    onnx.checker.check_model(model)
    write_bytes(path, model.SerializeToString())


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("state", type=Path, help="folder of the state, or an exported file (its graph is written anew)")
    parser.add_argument("--out", type=Path, default=Path("pointmap.onnx"))
    parser.add_argument("--size", type=int, nargs=2, default=(240, 320), help="height and width, as trained")
    parser.add_argument("--precision", choices=PRECISIONS, default="float16")
    o = parser.parse_args()
    try:
        made = write(shipped.any_of(o.state), o.out, tuple(o.size), o.precision)
    except RealsimError as error:
        print(error.render(), file=sys.stderr)
        sys.exit(2)
    for name, value in made.off.items():
        print(f"{name:<14} stored as {o.precision}: differs by {value:.2g} of its spread")
    print(
        f"{made.megabytes:.1f} MB" + (f", more than the {LIMIT_MB:g} MB that ship" if made.megabytes > LIMIT_MB else "")
    )


if __name__ == "__main__":
    main()
