"""VGGT (https://github.com/facebookresearch/vggt) to ONNX, with its depth head and its cameras.

    python tools/export_onnx/vggt.py facebook/VGGT-1B --out vggt.onnx

The weights of VGGT-1B are for research; facebook/VGGT-1B-Commercial (on request) may be used commercially. Written
against the public code; the weights have not been run here (docs/models.md).
"""

import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.export_onnx.blockers import Wrapped, replace_tables
from tools.export_onnx.common import Family, Options, main

METADATA = {
    "kind": "depth", "norm": "identity", "patch": "14", "fit": "pad_white", "pose": "pose_enc9", "conf": "exp1",
    "scale": "none", "family": "vggt",
}  # fmt: skip


def load(options: Options) -> torch.nn.Module:
    """The model, by the project's own loader."""
    from vggt.models.vggt import VGGT

    return VGGT.from_pretrained(options.weights).float()


def wrap(model: Any, options: Options) -> Family:
    """Unprojected depth beats the point head, so that one and the tracker stay out. Pictures keep the traced size: the
    position embedding is resampled in Python."""
    for unused in ("point_head", "track_head"):
        setattr(model, unused, None)
    replace_tables(model)
    h, w = options.size
    said = {**METADATA, "fixed_hw": f"{h},{w}"}
    return Family(Wrapped(model, run), ("pose_enc", "depth", "depth_conf"), said, {"images": {1: "views"}})


def run(model: Any, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """pose_enc (1, N, 9), depth (1, N, H, W, 1), depth_conf (1, N, H, W) of images (1, N, 3, H, W)."""
    found = model(images)
    return found["pose_enc"], found["depth"], found["depth_conf"]


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
