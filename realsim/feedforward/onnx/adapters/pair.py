"""Two images, both pointmaps in the first camera's frame (DUSt3R, MASt3R); `onnx.place.place_pairs` joins them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from realsim.feedforward.onnx.adapters.base import Adapter, Call, Prediction, as_maps, read_claim, read_conf, read_mask


def unpack(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """Two views whose "local" points are both in the first camera's frame; poses are the identity by definition."""
    one = replace(call, n=1, ran=1)
    points = np.concatenate([as_maps(r, found[r], one, 3) for r in ("points", "other_points")])
    conf = np.concatenate([read_conf(found, one, r) for r in ("conf", "other_conf")])
    # Seen from the first camera, what the second one sees may well lie behind.
    finite = np.isfinite(points).all(-1)
    mask = np.stack([read_mask({}, one, points[:1])[0], finite[1]])
    return Prediction(points, np.tile(np.eye(4), (2, 1, 1)), conf, mask, read_claim(found))


ADAPTER = Adapter(
    needs={
        "points": ("pts3d", "pts3d_1", "points"),
        "other_points": ("pts3d_in_other_view", "pts3d_2"),
    },
    takes={
        "conf": ("conf", "conf_1", "conf1"),
        "other_conf": ("conf_in_other_view", "conf_2", "conf2"),
        "metric_scale": ("metric_scale",),
    },
    unpack=unpack,
)
