"""Is depth in metres what the layout says? A wrong unit is off by a known factor, which shows in the figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from realsim.capture.config import CaptureConfig
from realsim.capture.survey import Look
from realsim.errors import CaptureError
from realsim.types import Frame

PLAUSIBLE_MEDIAN = (0.25, 8.0)
"""Metres: where the median depth of a capture of terrain in front of a person or a robot lies."""
UNITS = {"metres": 1.0, "millimetres": 1e-3, "1/5000 m (TUM)": 1 / 5000, "1/10000 m": 1e-4, "1/256 m": 1 / 256}


def check_unit(frames: Sequence[Frame], looks: Sequence[Look], config: CaptureConfig, source: Path) -> str | None:
    """A warning where the depth is at the edge of what is plausible, None where all is well.

    Raises:
        CaptureError: the median depth of the capture cannot be terrain in front of a camera; names the likely unit.
    """
    medians = [look.median_depth for look in looks if np.isfinite(look.median_depth)]
    if not medians:
        return None
    median = float(np.median(medians))
    low, high = PLAUSIBLE_MEDIAN
    if low <= median <= high:
        return None
    unit = getattr(frames[0].read_depth, "unit", None)
    likely = [n for n, u in UNITS.items() if unit and low <= median / unit * u <= high]
    raise CaptureError(
        "depth in an implausible unit",
        file=source,
        expected=f"a median depth between {low:g} and {high:g} m",
        found=f"{median:.4g} m" + (f" with {unit:g} m a step" if unit else ""),
        hint=f"likely {' or '.join(likely)}: pass --capture.depth-unit {UNITS[likely[0]]:g}" if likely else None,
    )
