"""Selects predicted pixels: confident enough, and not between foreground and background."""

from __future__ import annotations

import numpy as np

from realsim.core.types import F32, Bool

EDGE = 0.03
"""Relative bend of inverse depth over three pixels that is an edge. On a plane inverse depth is linear in the image, so
a plane bends nowhere, however slanted it is seen."""


def believed(depth: F32, conf: F32, mask: Bool, min_confidence: float, drop_percent: float) -> Bool:
    """(H, W) of one view: valid, at least `min_confidence`, not among the `drop_percent` least sure, off the edges.

    The limit by percentile is that of this view: a model is more or less sure of whole views, and a limit over all of
    them would empty some.
    """
    keep = mask & np.isfinite(depth) & (depth > 0) & (conf >= min_confidence)
    if drop_percent > 0 and keep.any():
        keep &= conf >= np.percentile(conf[keep], drop_percent)
    return keep & ~edges(depth, mask)


def edges(depth: F32, mask: Bool) -> Bool:
    """Pixels next to a step of depth (flying pixels lie there), and those beside what is not valid at all."""
    valid = mask & np.isfinite(depth) & (depth > 0)
    q = np.divide(1, depth, out=np.zeros_like(depth), where=valid)
    out = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        v, ok, hit = (np.moveaxis(a, axis, 0) for a in (q, valid, out))
        bend = np.abs(v[2:] - 2 * v[1:-1] + v[:-2])
        step = ok[2:] & ok[1:-1] & ok[:-2] & (bend > EDGE * v[1:-1])
        for shifted in (hit[2:], hit[1:-1], hit[:-2]):
            shifted |= step
    return out
