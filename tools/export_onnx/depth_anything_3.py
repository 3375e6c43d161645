"""Depth Anything 3 (https://github.com/ByteDance-Seed/Depth-Anything-3) to ONNX: depth, cameras and poses.

    python tools/export_onnx/depth_anything_3.py depth-anything/DA3-BASE --out da3_base.onnx

The weights of SMALL and BASE are Apache-2.0; LARGE and GIANT are CC BY-NC. Written against the public code; the
weights have not been run here (docs/models.md).
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
    "kind": "depth", "norm": "imagenet", "patch": "14", "fit": "resize", "pose": "w2c", "conf": "exp1",
    "scale": "none", "family": "depth_anything_3",
}  # fmt: skip


def load(options: Options) -> torch.nn.Module:
    """The network inside the project's API object: what is around it reads files and writes results."""
    from depth_anything_3.api import DepthAnything3

    return DepthAnything3.from_pretrained(options.weights).model.float()


def wrap(model: Any, options: Options) -> Family:
    """The traced size stays; the views are free."""
    replace_tables(model)
    h, w = options.size
    said = {**METADATA, "fixed_hw": f"{h},{w}"}
    return Family(
        Wrapped(model, run), ("depth", "depth_conf", "extrinsics", "intrinsics"), said, {"images": {1: "views"}}
    )


def run(model: Any, images: Tensor) -> tuple[Tensor, ...]:
    """depth, depth_conf (1, N, H, W), extrinsics (1, N, 3, 4) world to camera, intrinsics (1, N, 3, 3)."""
    found = model(images)
    return found["depth"], found["depth_conf"], found["extrinsics"][..., :3, :], found["intrinsics"]


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
