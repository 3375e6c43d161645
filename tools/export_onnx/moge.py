"""MoGe-2 (https://github.com/microsoft/MoGe; code and weights MIT) to ONNX: one view a run.

    python tools/export_onnx/moge.py Ruicheng/moge-2-vitl-normal --out moge2.onnx --views 1

Written against the public code; the weights have not been run here (docs/models.md).
"""

import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.export_onnx.blockers import Wrapped, replace_group_norm
from tools.export_onnx.common import Family, Options, main

METADATA = {
    "kind": "mono", "norm": "identity", "patch": "14", "fit": "resize", "conf": "none", "scale": "factor",
    "max_views": "1", "n_static": "1", "family": "moge2",
}  # fmt: skip
TOKENS = 1800
"""Of the trace; the input stays free."""


def load(options: Options) -> torch.nn.Module:
    """The model, by the project's own loader."""
    from moge.model.v2 import MoGeModel

    return MoGeModel.from_pretrained(options.weights).float()


def wrap(model: Any, options: Options) -> Family:
    """The project's own switch makes its graph exportable, by torch's older exporter only: the number of tokens is an
    input, and the newer one cannot reason about sizes that follow from data. The host finds focal length and shift."""
    model.onnx_compatible_mode = True
    replace_group_norm(model)
    h, w = options.size
    said = {**METADATA, "fixed_hw": f"{h},{w}"}
    tokens = lambda images: {"num_tokens": torch.tensor(TOKENS, dtype=torch.int64)}  # noqa: E731
    outputs = ("points", "mask", "metric_scale")
    return Family(
        Wrapped(model, run), outputs, said, batched=False, image="image", extra=tokens, exporter="torchscript"
    )


def run(model: Any, image: Tensor, num_tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """points (1, H, W, 3) up to scale and a shift along z, mask (1, H, W), metres per unit (1,)."""
    found = model(image, num_tokens)
    return found["points"], found["mask"], found["metric_scale"]


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
