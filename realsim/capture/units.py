"""Is depth in metres what the layout says? A wrong unit is off by a known factor, which shows in the figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from realsim.capture.survey import Look
from realsim.core.errors import CaptureError
from realsim.core.types import Frame

PLAUSIBLE_MEDIAN = (0.25, 8.0)
"""Metres: where the median depth of a capture of terrain in front of a person or a robot lies."""
USUAL_MEDIAN = (0.45, 5.0)
"""Metres: where it usually lies; a unit wrong by 5 (TUM for millimetres) often ends between the two ranges."""
UNITS = {"metres": 1.0, "millimetres": 1e-3, "1/5000 m (TUM)": 1 / 5000, "1/10000 m": 1e-4, "1/256 m": 1 / 256}


def check_unit(frames: Sequence[Frame], looks: Sequence[Look], source: Path) -> str | None:
    """A warning where the depth is at the edge of what is plausible, None where all is well.

    Raises:
        CaptureError: the median depth of the capture cannot be terrain in front of a camera; names the likely unit.
    """
    medians = [look.median_depth for look in looks if np.isfinite(look.median_depth)]
    if not medians:
        return None
    median = float(np.median(medians))
    unit = step_of(frames[0])
    found = f"{median:.4g} m" + (f" with {unit:g} m a step" if unit else "")
    if _within(median, PLAUSIBLE_MEDIAN):
        if _within(median, USUAL_MEDIAN):
            return None
        return f"the median depth is {found}: unusual, check the unit (--depth-unit)"
    likely = [name for name, u in UNITS.items() if unit and _within(median / unit * u, USUAL_MEDIAN)]
    raise CaptureError(
        "depth in an implausible unit",
        file=source,
        expected=f"a median depth between {PLAUSIBLE_MEDIAN[0]:g} and {PLAUSIBLE_MEDIAN[1]:g} m",
        found=found,
        hint=f"likely {' or '.join(likely)}: pass --depth-unit {UNITS[likely[0]]:g}" if likely else None,
    )


def step_of(frame: Frame) -> float | None:
    """Metres that the value 1 stands for in the frame's depth file, where its reader can tell."""
    step = getattr(frame.read_depth, "step", None)
    return None if step is None else step()


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
