"""From pointmaps up to scale to a metric scene, with an interval and a refusal where frames disagree."""

from dataclasses import replace

import numpy as np

from realsim.core.errors import ScaleError
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.registry import Registry
from realsim.core.statistics import Z90, interval90, resampled
from realsim.core.types import F32, F64, Bool, MetricScene, Pointmaps, PointView, ScaleEstimate
from realsim.scale.config import ScaleConfig
from realsim.scale.reference import Reference, measure

ESTIMATORS = Registry(
    "scale estimator",
    {
        "median": "realsim.scale.estimators:median",
        "least_squares": "realsim.scale.estimators:least_squares",
        "ransac": "realsim.scale.estimators:ransac",
    },
)
"""name -> f(sensor (M,), predicted (M,), confidence (M,), lower (M,) bool, rng) -> metres per unit, NaN if unknown."""
FEW_PIXELS = 200
"""A frame with fewer pixels valid in both sensor and prediction says nothing about scale."""
CLAIM_LIMIT = 0.1
"""Relative difference between a model's own claim of scale and the sensor's from which the report warns."""
NAMED = 5
"""At most this many frames are named in a message."""


def to_metric(
    points: Pointmaps, config: ScaleConfig, up_world: F64 | None = None, sensor_sigma: float = 0.006
) -> MetricScene:
    """Give pointmaps their metres.

    Views are read once for the estimate, one in memory at a time, and scaled when they are loaded again.

    Args:
        points: N views and poses up to scale; both are multiplied by the same number.
        up_world: (3,) direction against gravity in the capture's world, where the source knows it. It tells which
            half of an image is the lower one when the camera was held sideways or upside down; without it the lower
            half is that of the rows as stored. Of poses in a world that the backend chose it says nothing.
        sensor_sigma: relative standard error of the depth sensor's own scale, where `config` does not say.

    Raises:
        ScaleError: no frame has sensor depth to compare with, or frames disagree beyond `config.max_spread`.
    """
    ratio = ESTIMATORS[config.method]
    up_world = up_world if points.world_is_capture else None

    def of_frame(i: int) -> float:
        pixels = _paired(points, i, up_world)
        return float("nan") if pixels is None else ratio(*pixels, np.random.default_rng([config.seed, i]))

    ratios = list(track(in_order(of_frame, len(points)), "scale", len(points)))
    names = [f.name for f in points.frames]
    scale = estimate(np.array(ratios), names, config)
    own = _sensor_sigma(points, config.sensor_sigma if config.sensor_sigma is not None else sensor_sigma)
    if np.allclose(np.array(ratios)[np.isfinite(ratios)], 1.0, atol=1e-4):  # the points are the sensor's own
        corrected = points.depth_gain_sigma is not None and np.isfinite(points.depth_gain_sigma)
        scale = replace(scale, method="the capture's poses" if corrected else "sensor depth")
    known = measure(points, config)
    scale = with_sensor(scale, own) if known is None else by_reference(known, scale, own, names, config)
    scale = with_claim(scale, points.metric_claim)

    poses = points.T_world_camera.copy()
    poses[:, :3, 3] *= scale.value

    def load(i: int) -> PointView:
        view = points.load(i)
        return view if scale.value == 1 else replace(view, points=view.points * np.float32(scale.value))

    return MetricScene(
        frames=points.frames,
        T_world_camera=poses,
        load=load,
        scale=scale,
        backend=points.backend,
        world_is_capture=points.world_is_capture,
        up_world=up_world,
        depth_gain=points.depth_gain,
        dropped=points.dropped,
        warnings=points.warnings,
        statistics=points.statistics,
    )


def estimate(ratios: F64, names: list[str], config: ScaleConfig) -> ScaleEstimate:
    """Scale from N frames: the median of their ratios, a bootstrap interval, and their disagreement.

    Args:
        ratios: (N,) metres per unit for each frame, NaN where a frame cannot tell.
        names: the frames' names, for messages.

    Raises:
        ScaleError: no ratio at all, or the robust spread is above `config.max_spread`.
    """
    seen = np.isfinite(ratios) & (ratios > 0)
    if not seen.any():
        raise ScaleError(
            "the metric scale cannot be determined",
            expected=f"frames with at least {FEW_PIXELS} pixels that have both sensor depth and a predicted point",
            found=f"none of {len(ratios)} frames",
            hint="capture with depth, or bring metric poses",
        )
    known = ratios[seen]
    value = float(np.median(known))
    spread = float(1.4826 * np.median(np.abs(known / value - 1)))
    outvoted = _disagreeing(ratios, names, value, max(3 * spread, config.warn_spread))
    if spread > config.max_spread:
        raise ScaleError(
            "frames disagree about the metric scale",
            expected=f"a relative spread of at most {config.max_spread:g}",
            found=f"a spread of {spread:.3f} over {len(known)} frames; the furthest from the median {value:.4g}: "
            + _disagreeing(ratios, names, value, 0.0),
            hint="drop those frames, choose another backend, or raise the limit max_spread if this is good enough",
        )
    warnings = []
    if spread > config.warn_spread:
        warnings.append(f"frames disagree about the scale: a spread of {100 * spread:.1f} percent")
    if outvoted:
        warnings.append(f"frames whose own scale is far from the median {value:.4g} were outvoted: {outvoted}")
    if not seen.all():
        silent = [name for name, ok in zip(names, seen, strict=True) if not ok]
        more = f" and {len(silent) - NAMED} more" if len(silent) > NAMED else ""
        warnings.append(f"no scale from frames with too little sensor depth: {', '.join(silent[:NAMED])}{more}")
    if len(known) == 1:
        warnings.append("one frame alone gives the scale: its interval is not meaningful")
    return ScaleEstimate(
        value=value,
        ci90=bootstrap_median(known, config.bootstrap, config.seed),
        per_frame=tuple(float(r) for r in ratios),
        per_frame_spread=spread,
        method=config.method,
        warnings=tuple(warnings),
    )


def with_sensor(scale: ScaleEstimate, sigma: float) -> ScaleEstimate:
    """Widen the interval by the sensor's own relative scale error `sigma`, which all frames share.

    Frames that agree with each other tell how well the ratio is known, not whether the sensor measures true metres.
    The two errors are independent: their 90 percent half widths add in squares.
    """
    low, high = scale.ci90
    own = Z90 * sigma * scale.value
    down, up = np.hypot(scale.value - low, own), np.hypot(high - scale.value, own)
    return replace(scale, ci90=(float(scale.value - down), float(scale.value + up)), sensor_sigma=sigma)


def by_reference(
    known: Reference, of_depth: ScaleEstimate, sigma: float, names: list[str], config: ScaleConfig
) -> ScaleEstimate:
    """The scale by a thing of known size, and a warning where depth of that `sigma` says otherwise."""
    scale = replace(estimate(known.ratios, names, config), method=known.name)
    off = of_depth.value / scale.value - 1
    warnings = [w for w in scale.warnings if not w.startswith("no scale from frames")]
    if abs(off) > 3 * np.hypot(sigma, known.sigma):
        warnings.append(f"{of_depth.method} says {100 * off:+.1f} percent of what {known.name} says, which is believed")
    return with_sensor(replace(scale, warnings=tuple(warnings)), known.sigma)


def with_claim(scale: ScaleEstimate, claim: float | None) -> ScaleEstimate:
    """Say so where a model's own claim of metres per unit is off; the claim is never used."""
    if claim is None or abs(claim / scale.value - 1) <= CLAIM_LIMIT:
        return scale
    off = 100 * (claim / scale.value - 1)
    text = f"the model claims {claim:.4g} metres per unit, the depth sensor says {scale.value:.4g} ({off:+.0f} percent)"
    return replace(scale, warnings=(*scale.warnings, f"{text}: the sensor is believed"))


def _sensor_sigma(points: Pointmaps, own: float) -> float:
    """Relative standard error of the metres, `own` being that of the depth sensor's calibration.

    Where poses corrected the depth there are two sources of metres, which differ by the gain. How much they differ may
    be known well; which of them errs is not: half of it is the standard error of their mean (the external consistency
    of two measurements, Birge 1932).
    """
    known = points.depth_gain_sigma
    if known is None or not np.isfinite(known) or known >= own:
        return own
    return float(np.hypot(known, np.log(points.depth_gain) / 2))


def bootstrap_median(values: F64, resamples: int, seed: int) -> tuple[float, float]:
    """90 percent percentile interval of the median, resampling whole frames (Efron 1979).

    Pixels of one frame err together, so it is frames that are drawn, not pixels. Depth images are float32: the
    interval is never narrower than their resolution.
    """
    low, high = interval90(np.median(resampled(values, resamples, seed), axis=1))
    eps = float(np.finfo(np.float32).eps)
    return float(low) * (1 - eps), float(high) * (1 + eps)


def _disagreeing(ratios: F64, names: list[str], value: float, limit: float) -> str:
    """`name (ratio)` of the frames further than `limit` from the median, the furthest first; empty if none."""
    off = np.abs(np.log(np.where(ratios > 0, ratios, np.nan) / value))
    order = [int(i) for i in np.argsort(-np.nan_to_num(off)) if np.isfinite(off[i]) and off[i] > limit]
    text = ", ".join(f"{names[i]} ({ratios[i]:.4g})" for i in order[:NAMED])
    return text + (f" and {len(order) - NAMED} more" if len(order) > NAMED else "")


def _paired(points: Pointmaps, i: int, up_world: F64 | None) -> tuple[F64, F64, F64, Bool] | None:
    """Corrected sensor depth, predicted depth, confidence, in the lower half: (M,) each, of pixels valid in both."""
    view = points.load(i)
    predicted = view.points[..., 2]
    sensor = _resampled(points.frames[i].depth(), predicted.shape) * np.float32(points.depth_gain)
    both = view.mask & (sensor > 0) & np.isfinite(sensor) & np.isfinite(predicted) & (predicted > 0)
    if np.count_nonzero(both) < FEW_PIXELS:
        return None
    lower = lower_half(predicted.shape, points.T_world_camera[i], up_world)
    return (
        sensor[both].astype(np.float64),
        predicted[both].astype(np.float64),
        view.confidence[both].astype(np.float64),
        lower[both],
    )


def lower_half(shape: tuple[int, ...], T_world_camera: F64, up_world: F64 | None) -> Bool:
    """(H, W) bool: the half of the image that lies below its centre, as the camera was held.

    Without `up_world`: the lower rows. With it: the half on the side (of the four) that gravity points to. A camera
    that looks almost straight down has no such side, and the rows decide.
    """
    height, width = shape
    down = np.array([0.0, 1.0]) if up_world is None else -(T_world_camera[:3, :3].T @ up_world)[:2]
    if np.linalg.norm(down) < 0.3:
        down = np.array([0.0, 1.0])
    half = np.zeros((height, width), bool)
    if abs(down[1]) >= abs(down[0]):
        half[slice(height // 2, None) if down[1] > 0 else slice(None, height - height // 2)] = True
    else:
        half[:, slice(width // 2, None) if down[0] > 0 else slice(None, width - width // 2)] = True
    return half


def _resampled(depth: F32, shape: tuple[int, ...]) -> F32:
    """Depth (H, W) on another grid by nearest pixel centre: averaging would invent depth between near and far."""
    if depth.shape == shape:
        return depth
    (h, w), (H, W) = depth.shape, shape
    rows = np.minimum(((np.arange(H) + 0.5) * h / H).astype(int), h - 1)
    columns = np.minimum(((np.arange(W) + 0.5) * w / W).astype(int), w - 1)
    return depth[np.ix_(rows, columns)]
