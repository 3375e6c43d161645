"""Statistics that several stages share: the bootstrap, and the correlation of two signals.

The bootstrap (Efron 1979) draws whole units: frames, blocks of ground, half seconds of a log.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

Z90 = 1.6449
"""Standard deviations of a Gaussian from its middle to either end of a 90 percent interval."""


@dataclass(frozen=True)
class Interval:
    """A value with its 90 percent interval."""

    value: float
    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.text('.3g')} {self.unit}".rstrip()

    def text(self, form: str, scale: float = 1.0, unit: str = "") -> str:
        """`1.9 N m [1.6, 2.2]`: each number times `scale` in a format; the ends never with a plus sign."""
        low, high = (f"{scale * v:{form.lstrip('+')}}" for v in (self.low, self.high))
        return f"{scale * self.value:{form}}{unit} [{low}, {high}]"

    def as_dict(self) -> dict[str, Any]:
        """As diagnosis.json and footholds.json have it."""
        return {"value": self.value, "unit": self.unit, "ci90": [self.low, self.high]}


def resampled(values: F64, resamples: int, seed: int) -> F64:
    """(resamples, N, ...) of (N, ...) values, each row drawn from them with replacement."""
    picked = np.random.default_rng(seed).integers(0, len(values), (resamples, len(values)))
    return values[picked]


def interval90(samples: F64) -> F64:
    """(2, ...) 5 and 95 percent quantiles of (resamples, ...) values."""
    return np.asarray(np.quantile(samples, [0.05, 0.95], axis=0))


def alike(a: F64, b: F64) -> float:
    """Correlation of two signals (T,) where both are finite; 0 where one does not move or fewer than 20 samples are."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 20:
        return 0.0
    x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-12 * good.sum() else 0.0
