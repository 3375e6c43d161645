"""DUSt3R and MASt3R (https://github.com/naver/dust3r, /mast3r) to ONNX: one pair a run.

    python tools/export_onnx/dust3r.py naver/DUSt3R_ViTLarge_BaseDecoder_512_dpt --out dust3r.onnx --size 384 512
    python tools/export_onnx/dust3r.py naver/MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric --out mast3r.onnx ...

Code and weights are CC BY-NC-SA: not for commercial use. Written against the public code; the weights have not been run
here (docs/models.md).
"""

import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.export_onnx.blockers import Wrapped, grid_positions, replace_tables
from tools.export_onnx.common import ExportFailed, Family, Options, main

METADATA = {
    "kind": "pair", "norm": "half", "patch": "16", "fit": "crop", "conf": "exp1", "max_views": "2", "n_static": "2",
}  # fmt: skip


def load(options: Options) -> torch.nn.Module:
    """The model, by the project's own loader; MASt3R's if the name says so."""
    if "mast3r" in options.weights.lower():
        from mast3r.model import AsymmetricMASt3R as Model
    else:
        from dust3r.model import AsymmetricCroCo3DStereo as Model
    return Model.from_pretrained(options.weights).float()


def wrap(model: Any, options: Options) -> Family:
    """Two landscape pictures of the traced size. MASt3R's metric weights claim metres; DUSt3R is up to scale."""
    h, w = options.size
    if h > w:
        raise ExportFailed(f"the model takes landscape pictures, --size is {h} {w} (height, width): swap them")
    replace_tables(model)
    metric = "metric" in options.weights.lower()
    said = {**METADATA, "fixed_hw": f"{h},{w}", "scale": "applied" if metric else "none"}
    said["family"] = "mast3r" if "mast3r" in options.weights.lower() else "dust3r"
    return Family(Wrapped(model, run), ("pts3d", "conf_1", "pts3d_in_other_view", "conf_2"), said, batched=False)


def run(model: Any, images: Tensor) -> tuple[Tensor, ...]:
    """Points (1, H, W, 3) and confidences (1, H, W) of both pictures in images (2, 3, H, W), first camera's frame.

    The model's own forward takes the pictures' size as a tensor and branches on it. Here the size is known, so its
    parts are called with numbers instead.
    """
    h, w = images.shape[-2:]
    patches = model.patch_embed.proj(images)
    place = grid_positions(2, patches.shape[2], patches.shape[3], images.device)
    tokens = model.patch_embed.norm(patches.flatten(2).transpose(1, 2))
    for block in model.enc_blocks:
        tokens = block(tokens, place)
    one, two = model.enc_norm(tokens).chunk(2)
    decoded = model._decoder(one, place[:1], two, place[1:])
    a, b = (
        head([t.float() for t in side], (h, w))
        for head, side in zip((model.downstream_head1, model.downstream_head2), decoded, strict=True)
    )
    return a["pts3d"], a["conf"], b["pts3d"], b["conf"]


if __name__ == "__main__":
    main(load, wrap, __doc__ or "")
