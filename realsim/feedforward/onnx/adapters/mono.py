"""Points of a single view, whose focal length and distance along z are still to be found (MoGe).

Such a model knows points up to a scale and a shift along z. Both follow from where the points must project to.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F32, F64, Bool
from realsim.feedforward.onnx.adapters.base import (
    CONF_NAMES,
    MASK,
    Adapter,
    Call,
    Prediction,
    as_maps,
    read_claim,
    read_conf,
    read_mask,
    unproject,
)

SAMPLES = 4000


def unpack(found: Mapping[str, NDArray], call: Call) -> Prediction:
    """One view a run; the pose is unknown (NaN)."""
    points = as_maps("points", found["points"], call, 3).copy()
    usable: Bool = np.asarray(np.isfinite(points).all(-1))
    if "mask" in found:
        usable &= as_maps("mask", found["mask"].astype(np.float32), call, 1) > 0.5
    rays = unproject(np.ones(points.shape[:3], np.float32), call.intrinsics)[..., :2]
    ratios = []
    for k in range(call.n):
        shift, ratio = shift_and_focal(points[k], rays[k], usable[k])
        points[k, ..., 2] += np.float32(shift)
        ratios.append(ratio)
    mask = read_mask(found, call, points)
    T = np.full((call.n, 4, 4), np.nan)
    figures = {"focal_ratio": float(np.median(ratios))}
    return Prediction(points, T, read_conf(found, call), mask, read_claim(found), figures)


def shift_and_focal(points: F32, rays: F64 | F32, mask: Bool) -> tuple[float, float]:
    """The s and f that minimise |f (x, y) / (z + s) - ray|^2 over the pixels of `mask`; (0, nan) with too few.

    Args:
        points: (H, W, 3) with an unknown shift along z.
        rays: (H, W, 2) directions x / z, y / z of the known camera.

    Returns:
        Shift, and the model's focal length over the known one. For a given shift the best f is a ratio of sums, which
        leaves a search in one number.
    """
    from scipy.optimize import least_squares

    at = np.flatnonzero(mask)
    if len(at) < 10:
        return 0.0, float("nan")
    at = at[np.linspace(0, len(at) - 1, min(SAMPLES, len(at))).astype(int)]
    p, d = points.reshape(-1, 3)[at].astype(float), np.asarray(rays, float).reshape(-1, 2)[at]
    unit = float(np.median(np.abs(p[:, 2])) + np.ptp(p[:, 2]) + 1e-9)
    # The nearest point lies in front of the camera, whatever the search tries.
    low = -float(p[:, 2].min())

    def focal(s: float) -> tuple[F64, float]:
        q = p[:, :2] / np.maximum(p[:, 2:] + s, 1e-6 * unit)
        return q, float((q * d).sum() / max((q * q).sum(), 1e-12))

    def residual(x: F64) -> F64:
        q, f = focal(low + unit * float(np.exp(x[0])))
        return (f * q - d).ravel()

    best = min(
        (least_squares(residual, [x0], loss="soft_l1", f_scale=0.02) for x0 in (-3.0, -1.0, 1.0)), key=lambda r: r.cost
    )
    shift = low + unit * float(np.exp(best.x[0]))
    return shift, focal(shift)[1]


ADAPTER = Adapter(
    needs={"points": ("points", "pts3d")},
    takes={"conf": CONF_NAMES, **MASK},
    unpack=unpack,
)
