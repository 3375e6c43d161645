"""How alike two signals are."""

from __future__ import annotations

import numpy as np

from realsim.types import F64


def alike(a: F64, b: F64) -> float:
    """Correlation of two signals (T,) where both are finite; 0 where one does not move or fewer than 20 samples are."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 20:
        return 0.0
    x, y = a[good] - a[good].mean(), b[good] - b[good].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-12 * good.sum() else 0.0
