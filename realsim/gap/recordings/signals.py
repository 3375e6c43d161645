"""How alike two signals are: the measures that evidence about roles, orders, units and signs is made of."""

import numpy as np

from realsim.core.filters import local_polynomials
from realsim.core.statistics import alike
from realsim.core.types import F64
from realsim.gap.case.units import factor

MOST = 20_000
"""Samples that are compared; longer logs are thinned."""
MAX_LAG = 0.3
"""s by which a joint may follow its command."""


def at(times: F64, values: F64, wanted: F64) -> F64:
    """(T, K) values between their samples, linear; NaN outside, and in gaps of more than five usual steps."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else np.inf
    out = np.full((len(wanted), values.shape[1]), np.nan)
    for k in range(values.shape[1]):
        good = np.isfinite(values[:, k])
        if good.sum() < 2:
            continue
        t = times[good]
        out[:, k] = np.interp(wanted, t, values[good, k], left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
        out[(t[after] - t[after - 1]) > 5 * step + 1e-9, k] = np.nan
        out[np.isin(wanted, t), k] = values[good, k][np.searchsorted(t, wanted[np.isin(wanted, t)])]
    return out


def held(times: F64, values: F64, wanted: F64) -> F64:
    """(T, K) the newest value at or before each moment; NaN before the first."""
    index = np.searchsorted(times, wanted, side="right") - 1
    out = values[np.clip(index, 0, None)].copy()
    out[index < 0] = np.nan
    return out


def follows(times: F64, commanded: F64, done: F64) -> tuple[float, float, float, float]:
    """(correlation, s of lag, gain, offset) with which one signal (T,) follows another best; zeros for two samples."""
    times, commanded, done = (x[np.isfinite(times)] for x in (times, commanded, done))
    if len(times) < 3:
        return 0.0, 0.0, np.nan, np.nan
    step = max(float(np.median(np.diff(times))), 1e-3)
    grid = np.arange(times[0], times[-1], step)[:MOST]
    a = held(times, commanded[:, None], grid)[:, 0]
    b = at(times, done[:, None], grid)[:, 0]
    best = (0.0, 0.0)
    for lag in range(min(int(MAX_LAG / step) + 1, len(a) // 2)):
        found = alike(a[: len(a) - lag], b[lag:])
        if found > best[0] + 1e-9:
            best = (found, lag)
    corr, lag = best[0], int(best[1])
    x, y = a[: len(a) - lag], b[lag:]
    gain = factor(y, x)
    offset = float(np.nanmedian(y - gain * x)) if np.isfinite(gain) else np.nan
    return corr, lag * step, gain, offset


def smooth_derivatives(times: F64, position: F64, width: float = 0.03) -> tuple[F64, F64, F64]:
    """(position, velocity, acceleration) (T, K) by local quadratics (Savitzky and Golay 1964) on an even grid."""
    step = float(np.median(np.diff(times)))
    window = max(5, 2 * round(width / step) + 1)
    if len(position) <= window:
        return position, np.zeros_like(position), np.zeros_like(position)
    value, rate, change = (local_polynomials(position, window, 2, d, step) for d in (0, 1, 2))
    return value, rate, change


def upward(quat_wxyz: F64) -> F64:
    """(T, 3) the vertical in the body's axes."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]]).inv().apply([0.0, 0.0, 1.0]))


def turning(times: F64, quat_wxyz: F64) -> F64:
    """(T - 1, 3) rad/s in the body's axes between samples of an orientation."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]])
    return np.asarray((turn[:-1].inv() * turn[1:]).as_rotvec()) / np.diff(times)[:, None]
