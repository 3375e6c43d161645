"""MapAnything (https://github.com/facebookresearch/map-anything) to ONNX, pictures only.

    python tools/export_onnx/map_anything.py facebook/map-anything-apache --out mapanything.onnx --views 8

The weights of map-anything-apache are Apache-2.0; those of map-anything are CC BY-NC. Written against the public code;
the weights have not been run here (docs/models.md).
"""

import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.export_onnx.blockers import Wrapped
from tools.export_onnx.common import Family, Options, main

METADATA = {
    "kind": "pointmap", "norm": "imagenet", "patch": "14", "fit": "resize", "pose": "c2w", "conf": "exp1",
    "scale": "applied", "family": "map_anything",
}  # fmt: skip


def load(options: Options) -> torch.nn.Module:
    """The model, by the project's own loader."""
    from mapanything.models import MapAnything

    return MapAnything.from_pretrained(options.weights).float()


def wrap(model: Any, options: Options) -> Family:
    """Views are a Python list in this model: their number and size are frozen, and windows are filled up to it.
    Its points are metres as it sees them, hence scale applied: recorded as a claim, compared with the sensor."""
    h, w = options.size
    said = {**METADATA, "fixed_hw": f"{h},{w}", "n_static": str(options.views), "max_views": str(options.views)}
    return Family(Wrapped(model, run), ("pts3d_cam", "camera_poses", "conf"), said)


def run(model: Any, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """pts3d_cam (1, N, H, W, 3), camera_poses (1, N, 4, 4), conf (1, N, H, W) of images (1, N, 3, H, W)."""
    views = [{"img": images[:, k], "data_norm_type": ["dinov2"]} for k in range(images.shape[1])]
    found = model(views)
    points = torch.stack([v["pts3d_cam"] for v in found], 1)
    poses = torch.stack([pose(v["cam_quats"], v["cam_trans"]) for v in found], 1)
    return points, poses, torch.stack([v["conf"] for v in found], 1)


def pose(quat: Tensor, trans: Tensor) -> Tensor:
    """(B, 4, 4) camera to world of quaternions x y z w (B, 4) and translations (B, 3)."""
    x, y, z, w = (quat / quat.norm(dim=-1, keepdim=True)).unbind(-1)
    zero = torch.zeros_like(x)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), trans[:, 0]], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), trans[:, 1]], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), trans[:, 2]], -1),
        torch.stack([zero, zero, zero, zero + 1], -1),
    ]
    return torch.stack(rows, -2)


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
