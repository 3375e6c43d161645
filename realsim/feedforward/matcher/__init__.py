"""A learned matcher for pairs of pictures that classical features cannot match: XFeat and LighterGlue in onnxruntime.

The two networks lie beside this file (3.6 MB; NOTICE says where they come from, tools/export_xfeat.py makes them).
No torch. One thread, so that results do not depend on the number of cores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ModelError
from realsim.core.types import F32, F64, U8

FOLDER = Path(__file__).parent
FILES = (FOLDER / "xfeat.onnx", FOLDER / "lighterglue.onnx")
LONGEST = 1024
"""Pixels; larger pictures are made smaller first. XFeat was trained on pictures of 800 x 600."""
STEP = 32
"""Sizes are multiples of this: the network's coarsest grid."""
PEAK = 0.05
"""Keypoint probability below which there is none, and `LIKELY` that of a match: as in the authors' code."""
LIKELY = 0.1
KEEP = 2048
"""Most keypoints a picture."""


@dataclass(frozen=True)
class Keypoints:
    """Of one picture, the best first."""

    uv: F64
    """(K, 2) pixels, (0, 0) is the centre of the first one."""
    descriptors: F32
    """(K, 64) of unit length."""
    size: tuple[int, int]
    """Width and height of the picture."""

    def subset(self, keep: NDArray[Any]) -> Keypoints:
        """Those that an index or a mask selects."""
        return Keypoints(self.uv[keep], self.descriptors[keep], self.size)


def missing() -> str | None:
    """What has to be installed first; None if nothing."""
    if find_spec("onnxruntime") is None:
        return 'it needs the package onnxruntime (pip install "realsim[matching]")'
    return None


def extract(color: U8) -> Keypoints:
    """Keypoints of a picture (h, w, 3) uint8.

    Raises:
        RealsimError: the package onnxruntime is not installed.
        ModelError: the files of the networks are damaged.
    """
    import cv2

    h, w = color.shape[:2]
    shrink = min(1.0, LONGEST / max(h, w))
    size = [max(STEP, int(v * shrink) // STEP * STEP) for v in (w, h)]
    gray = color.mean(axis=2, dtype=np.float32)
    if (w, h) != tuple(size):
        gray = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.float32)
    grid, heat, reliability = _sessions()[0].run(None, {"image": gray[None, None]})
    heat, reliability = heat[0, 0], reliability[0, 0]
    top = np.asarray(cv2.dilate(heat, np.ones((5, 5), np.uint8)))
    rows, cols = np.nonzero((heat == top) & (heat > PEAK))
    sure = heat[rows, cols] * reliability[rows // 8, cols // 8]
    best = np.argsort(-sure, kind="stable")[:KEEP]
    at = np.column_stack([cols[best], rows[best]]).astype(float)
    descriptors = _sampled(grid[0], at * ((size[0] / 8) / (size[0] - 1), (size[1] / 8) / (size[1] - 1)) - 0.5)
    descriptors /= np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9)
    uv = (at + 0.5) * (w / size[0], h / size[1]) - 0.5
    return Keypoints(uv, descriptors, (w, h))


def match(a: Keypoints, b: Keypoints) -> NDArray[np.int64]:
    """(M, 2) indices of keypoints of `a` and `b` that are each other's likeliest match.

    Raises:
        RealsimError, ModelError: as `extract`.
    """
    if not len(a.uv) or not len(b.uv):
        return np.zeros((0, 2), np.int64)
    feeds = {}
    for k, side in enumerate((a, b)):
        centre = np.array(side.size) / 2
        feeds[f"keypoints{k}"] = ((side.uv - centre) / centre.max()).astype(np.float32)
        feeds[f"descriptors{k}"] = side.descriptors
    (score,) = _sessions()[1].run(None, feeds)
    rows = np.arange(len(score))
    best = score.argmax(1)
    keep = (score.argmax(0)[best] == rows) & (score[rows, best] > np.log(LIKELY))
    return np.column_stack([rows[keep], best[keep]])


def release() -> None:
    """Release the networks' memory; the next match loads them again."""
    _sessions.cache_clear()


@lru_cache(maxsize=1)
def _sessions() -> Sequence[Any]:
    from realsim.feedforward.onnx.session import runtime

    ort = runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return [ort.InferenceSession(str(f), options, providers=["CPUExecutionProvider"]) for f in FILES]
    except Exception as error:  # onnxruntime's own kinds have no common base
        raise ModelError(
            "the networks of the learned matcher cannot be loaded",
            file=FOLDER,
            found=" ".join(str(error).split())[:200],
            hint="install realsim again, or leave the learned matcher out (--no-learned-matches)",
        ) from error


def _sampled(grid: F32, at: F64) -> F32:
    """(K, C) values of a grid (C, h, w) at (K, 2) positions by cubic convolution (Keys 1981, a = -0.75), 0 outside."""
    channels, h, w = grid.shape
    base = np.floor(at).astype(int)
    weights = _cubic(at - base)
    out = np.zeros((len(at), channels), np.float32)
    for i in range(4):
        for j in range(4):
            c, r = base[:, 0] + j - 1, base[:, 1] + i - 1
            inside = (c >= 0) & (r >= 0) & (c < w) & (r < h)
            weight = (weights[:, 0, j] * weights[:, 1, i] * inside).astype(np.float32)
            out += weight[:, None] * grid[:, np.clip(r, 0, h - 1), np.clip(c, 0, w - 1)].T
    return out


def _cubic(t: F64) -> F64:
    """(K, 2, 4) weights of the taps at -1, 0, 1, 2 for offsets t (K, 2) in [0, 1)."""
    a = -0.75
    x = np.abs(t[..., None] - np.array([-1, 0, 1, 2]))
    near = (a + 2) * x**3 - (a + 3) * x**2 + 1
    far = a * (x**3 - 5 * x**2 + 8 * x - 4)
    return np.where(x <= 1, near, far)
