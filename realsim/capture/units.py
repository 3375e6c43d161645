"""Is depth in metres what the layout says? A wrong unit is off by a known factor, which shows in the figures."""

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
USUAL_HEIGHT = (0.1, 2.6)
"""Metres from the camera down to the level surface that it sees most of: a robot's chest, a raised arm, a table top."""
LEVEL_FRAMES, LEVEL_POINTS, LEVEL_TRIALS = 6, 1500, 150
"""Looked at for that surface. Budget."""
LEVEL_SHARE = 0.25
"""Of a frame's points that have to lie in a plane for it to be one."""
UPRIGHT = 0.35
"""Cosine of the steepest view down, of a camera that is held upright, from which a plane below it may be level."""
UNITS = {
    "metres": 1.0,
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "1/5000 m (TUM)": 1 / 5000,
    "1/4000 m (L515)": 1 / 4000,
    "1/10000 m": 1e-4,
    "1/256 m": 1 / 256,
}
SHIFTED = {"1/8000 m (SUN3D, whose millimetres are shifted by three bits)": 1 / 8000, **UNITS}
"""Where all values are multiples of eight."""


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
    steps = np.rint(frames[0].depth() / unit).astype(int) if unit else np.ones(1, int)
    units = SHIFTED if np.gcd.reduce(steps, axis=None) % 8 == 0 else UNITS
    likely = [name for name, u in units.items() if unit and _within(median / unit * u, USUAL_MEDIAN)]
    raise CaptureError(
        "depth in an implausible unit",
        file=source,
        expected=f"a median depth between {PLAUSIBLE_MEDIAN[0]:g} and {PLAUSIBLE_MEDIAN[1]:g} m",
        found=found,
        hint=f"likely {' or '.join(likely)}: pass --depth-unit {units[likely[0]]:g}" if likely else None,
    )


def check_height(frames: Sequence[Frame]) -> str | None:
    """A warning where the camera hangs higher over the ground, or lower, than anybody holds it; None where it does not,
    and where no ground is seen.

    It tells units apart whose depth alone is plausible in both (an L515's quarter millimetres).
    """
    chosen = [frames[k] for k in np.unique(np.linspace(0, len(frames) - 1, LEVEL_FRAMES).astype(int))]
    heights = [h for h in map(_height, chosen) if h is not None]
    unit = step_of(frames[0])
    if 2 * len(heights) <= len(chosen) or unit is None or _within(height := float(np.median(heights)), USUAL_HEIGHT):
        return None
    likely = [name for name, u in UNITS.items() if _within(height / unit * u, USUAL_HEIGHT) and u < 1]
    found = f"the camera is {height:.2g} m above the level surface that it sees most of"
    ways = ", ".join(f"{UNITS[name]:g} for {name}" for name in likely)
    return f"{found}: is the depth in another unit? (--depth-unit {ways})" if likely else f"{found}: is the unit right?"


def _height(frame: Frame) -> float | None:
    """Metres from an upright camera down to the plane that holds most of what it sees; None without such a plane."""
    depth = frame.depth()
    step = max(int(np.sqrt(depth.size / LEVEL_POINTS)), 1)
    z = depth[::step, ::step].astype(float)
    P = (frame.intrinsics.rays()[::step, ::step] * z[..., None])[z > 0]
    if len(P) < LEVEL_POINTS // 4:
        return None
    rng = np.random.default_rng(0)
    corners = P[rng.integers(0, len(P), (LEVEL_TRIALS, 3))]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(n, axis=1)
    n, corners = n[length > 0] / length[length > 0, None], corners[length > 0]
    n *= np.where(n[:, 1] < 0, 1, -1)[:, None]  # up: y points down
    height = -(n * corners[:, 0]).sum(1)
    near = np.abs(P @ n.T + height) < 0.015 * P[:, 2:]
    share = near.mean(0) * ((n[:, 1] < -UPRIGHT) & (height > 0))
    best = int(share.argmax()) if len(share) else 0
    return float(height[best]) if len(share) and share[best] > LEVEL_SHARE else None


def step_of(frame: Frame) -> float | None:
    """Metres that the value 1 stands for in the frame's depth file, where its reader can tell."""
    step = getattr(frame.read_depth, "step", None)
    return None if step is None else step()


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
