"""What every exporter does: write the graph, compare it with torch, and only then put it under its name.

An exporter runs where a person has installed a project and its weights; neither comes with realsim. It says what the
contract (docs/models.md) wants to know in the file's metadata, so that nothing has to be guessed later.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

os.environ["ORT_DISABLE_TELEMETRY"] = "1"


@dataclass(frozen=True)
class Options:
    weights: Annotated[str, tyro.conf.Positional]
    """A checkpoint, or the name under which the project's own loader finds one."""
    out: Path
    """The ONNX file to write; a large model gets a .data file beside it."""
    size: tuple[int, int] = (378, 504)
    """Height and width of the pictures that the graph is traced with, multiples of the patch."""
    views: int = 3
    """How many views it is traced with (frozen for families that cannot keep it free)."""
    opset: int = 18
    """Of the standard operators; a lower one runs on older onnxruntimes."""
    exporter: Literal["dynamo", "torchscript"] | None = None
    """Which of torch's two exporters; by default the one that the family needs."""
    tolerance: float = 1e-3
    """Largest relative difference between torch and onnxruntime, of each output's own spread."""


@dataclass(frozen=True)
class Family:
    """A model as it is exported."""

    module: Any
    """`torch.nn.Module`: tensors in, a tuple of tensors out."""
    outputs: tuple[str, ...]
    metadata: Mapping[str, str]
    """Keys and values of the contract."""
    free: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    """Input -> its axes that stay free: axis -> name."""
    batched: bool = True
    """Pictures as (1, N, 3, H, W); else (N, 3, H, W)."""
    image: str = "images"
    extra: Callable[[Any], dict[str, Any]] = lambda images: {}
    """Further inputs by name for given pictures."""
    exporter: Literal["dynamo", "torchscript"] = "dynamo"
    """The exporter that can write this family's graph."""


def main(load: Callable[[Options], Any], wrap: Callable[[Any, Options], Family], description: str) -> None:
    """The command line of an exporter."""
    options = tyro.cli(Options, description=description)
    try:
        export(wrap(load(options), options), options)
    except ExportFailed as error:
        sys.exit(f"not exported: {error}")
    print(f"written: {options.out}; look at it with: realsim model inspect {options.out}")


class ExportFailed(Exception):
    """The graph cannot be written, or says something else than torch."""


def export(family: Family, options: Options) -> dict[str, float]:
    """Write the graph into a temporary folder, compare, then move it to `options.out`.

    Returns:
        Output -> largest relative difference over all comparisons.

    Raises:
        ExportFailed: torch cannot export, onnxruntime cannot load or run, or the two disagree.
    """
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.out.parent, prefix=".export-") as folder:
        path = Path(folder) / options.out.name
        _write(family, options, path)
        _describe(path, family)
        off = compare(family, path, options)
        for file in Path(folder).iterdir():
            shutil.move(file, options.out.parent / file.name)
    for name, value in off.items():
        print(f"{name:<22} differs by {value:.2g} of its spread")
    return off


def sample(family: Family, views: int, size: tuple[int, int], seed: int = 0) -> dict[str, Any]:
    """Inputs by name: smooth random pictures, the same for the same seed."""
    import torch

    rng = np.random.default_rng(seed)
    h, w = size
    coarse = torch.from_numpy(rng.random((views, 3, 8, 8), np.float32))
    images = torch.nn.functional.interpolate(coarse, (h, w), mode="bicubic").clamp(0, 1)
    images = images[None] if family.batched else images
    return {family.image: images, **family.extra(images)}


def compare(family: Family, path: Path, options: Options) -> dict[str, float]:
    """Run torch and onnxruntime on the traced size and, where axes are free, on another number of views and size."""
    import onnxruntime
    import torch

    try:
        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ExportFailed(f"onnxruntime cannot load the graph: {error}") from error
    off = dict.fromkeys(family.outputs, 0.0)
    for k, (views, size) in enumerate(_trials(family, options)):
        feeds = sample(family, views, size, seed=k)
        with torch.no_grad():
            expected = [np.asarray(v.float()) for v in family.module(*feeds.values())]
        try:
            taken = {p.name for p in session.get_inputs()}
            found = session.run(list(family.outputs), {n: v.numpy() for n, v in feeds.items() if n in taken})
        except Exception as error:
            raise ExportFailed(f"onnxruntime fails with {views} views of {size[0]} x {size[1]}: {error}") from error
        for name, a, b in zip(family.outputs, expected, found, strict=True):
            if a.shape != b.shape:
                raise ExportFailed(f"{name}: torch gives {a.shape}, onnxruntime {b.shape} with {views} views of {size}")
            spread = float(np.abs(a - np.median(a)).mean()) or 1.0
            difference = float(np.abs(a - b).max()) / spread
            off[name] = max(off[name], difference if np.isfinite(difference) else float("inf"))
    if wrong := {n: v for n, v in off.items() if v > options.tolerance}:
        text = ", ".join(f"{n} by {v:.2g}" for n, v in wrong.items())
        raise ExportFailed(f"torch and onnxruntime disagree beyond {options.tolerance:g}: {text}")
    return off


def _trials(family: Family, options: Options) -> Sequence[tuple[int, tuple[int, int]]]:
    names = set(family.free.get(family.image, {}).values())
    patch = int(family.metadata.get("patch", 14))
    h, w = options.size
    out = [(options.views, options.size)]
    if "views" in names:
        out.append((options.views + 1, options.size))
    if "height" in names:
        out.append((options.views, (h, w - 2 * patch) if w > 4 * patch else (h, w + 2 * patch)))
    return out


def _write(family: Family, options: Options, path: Path) -> None:
    import torch

    from tools.export_onnx.blockers import Wrapped, head_by_head

    feeds = sample(family, options.views, options.size)
    family.module.eval()
    shared: dict[str, Any] = {"input_names": list(feeds), "output_names": list(family.outputs)}
    shared["opset_version"] = options.opset
    try:
        with torch.no_grad(), head_by_head(family.module):
            if (options.exporter or family.exporter) == "torchscript":
                axes = {name: dict(axes) for name, axes in family.free.items()}
                torch.onnx.export(
                    family.module, tuple(feeds.values()), str(path), dynamo=False, dynamic_axes=axes, **shared
                )
            else:
                each = tuple(_dimensions(family.free.get(name, {})) for name in feeds)
                free = (each,) if isinstance(family.module, Wrapped) else each  # a starred argument is one tuple
                torch.onnx.export(
                    family.module, tuple(feeds.values()), str(path), dynamo=True, dynamic_shapes=free,
                    external_data=_large(family.module), **shared,
                )  # fmt: skip
    except Exception as error:
        raise ExportFailed(f"torch cannot write the graph: {type(error).__name__}: {error}") from error


def _dimensions(axes: Mapping[int, str]) -> dict[int, Any]:
    """Free axes for the exporter; it works out for itself what has to be a multiple of what."""
    import torch

    return dict.fromkeys(axes, torch.export.Dim.DYNAMIC)


def _large(module: Any) -> bool:
    """Whether the weights exceed what fits into one protobuf."""
    return sum(p.numel() * p.element_size() for p in module.parameters()) > 1.8e9


def _describe(path: Path, family: Family) -> None:
    """Write the contract's keys into the file; weights beside it are not touched."""
    import onnx

    model = onnx.load(str(path), load_external_data=False)
    onnx.helper.set_model_props(model, dict(family.metadata))
    onnx.save(model, str(path))


VIEWS_AND_SIZE = {1: "views", 3: "height", 4: "width"}
"""Free axes of pictures (1, N, 3, H, W)."""
