"""Pi3 (https://github.com/yyfz/Pi3; code BSD-3, weights CC BY-NC: not for commercial use) to ONNX.

    python tools/export_onnx/pi3.py yyfz233/Pi3 --out pi3.onnx

Written against the public code of Pi3; the weights have not been run here (docs/models.md).
"""

import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.export_onnx.blockers import Wrapped, replace_tables, unit_rows
from tools.export_onnx.common import VIEWS_AND_SIZE, Family, Options, main

METADATA = {
    "kind": "pointmap", "norm": "identity", "patch": "14", "fit": "resize", "pose": "raw9", "conf": "logit",
    "scale": "none", "family": "pi3",
}  # fmt: skip


def load(options: Options) -> torch.nn.Module:
    """The model, by the project's own loader."""
    from pi3.models.pi3 import Pi3

    return Pi3.from_pretrained(options.weights).float()


def wrap(model: Any, options: Options) -> Family:
    """Stops before the SVD of the camera head (no ONNX operator): nine numbers and a translation go out instead."""
    replace_tables(model)
    return Family(
        Wrapped(model, run), ("local_points", "camera_poses", "conf"), METADATA, {"images": VIEWS_AND_SIZE}
    )  # fmt: skip


def run(model: Any, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """local_points (1, N, H, W, 3), camera_poses (1, N, 12), conf (1, N, H, W, 1) of images (1, N, 3, H, W)."""
    images = (images - model.image_mean) / model.image_std
    b, n, _, h, w = images.shape
    hidden = model.encoder(images.reshape(b * n, 3, h, w), is_training=True)
    hidden = hidden["x_norm_patchtokens"] if isinstance(hidden, dict) else hidden
    hidden, place = model.decode(hidden, n, h, w)
    skip = model.patch_start_idx
    points = model.point_head([model.point_decoder(hidden, xpos=place).float()[:, skip:]], (h, w))
    conf = model.conf_head([model.conf_decoder(hidden, xpos=place).float()[:, skip:]], (h, w))
    xy, z = points.reshape(b, n, h, w, 3).split([2, 1], dim=-1)
    z = z.exp()
    pose = _pose(model.camera_head, model.camera_decoder(hidden, xpos=place).float()[:, skip:])
    return torch.cat([xy * z, z], -1), pose.reshape(b, n, 12), conf.reshape(b, n, h, w, 1)


def _pose(head: Any, tokens: Tensor) -> Tensor:
    """(B, 12). The head's average pool over all patches is a mean; its size would be frozen by the operator."""
    for block in head.res_conv:
        tokens = block(tokens)
    feature = head.more_mlps(tokens.mean(1))
    return torch.cat([unit_rows(head.fc_rot(feature)), head.fc_t(feature)], -1)


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
