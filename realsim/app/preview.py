"""Pictures and points of what was opened: a few frames, or a thousand points of a surface."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import sampled
from realsim.core.types import F64, FrameSet
from realsim.report.raster import colorize, photo_uri

SHOWN = 4
"""Frames, spread over the capture."""
POINTS = 6000
WIDTH = 320
"""Pixels of a picture."""


@dataclass(frozen=True)
class Preview:
    """What the page shows beside the words."""

    pictures: tuple[tuple[str, str], ...] = ()
    """(caption, data URI)."""
    points: F64 | None = None
    """(M, 3) metres, as the file has its axes, about their middle."""
    colors: F64 | None = None
    """(M, 3) in 0..1, by height."""

    @property
    def reach(self) -> float:
        """Metres from the middle that hold nearly all points."""
        return 1.0 if self.points is None else float(np.percentile(np.linalg.norm(self.points, axis=1), 98)) or 1.0


def preview(path: Path) -> Preview:
    """Frames of a capture, or points of a mesh or scan.

    Raises:
        RealsimError: it cannot be read; the command that looks at it says more.
    """
    from realsim.capture import CaptureConfig, read

    found = read(path, CaptureConfig())
    if isinstance(found, FrameSet):
        chosen = np.unique(np.linspace(0, len(found) - 1, min(SHOWN, len(found))).round().astype(int))
        return Preview(tuple(_pictures(found, chosen.tolist())))
    some = _spread(np.asarray(found.points, float), found.triangles)
    some = some - np.median(some, axis=0)
    low, high = np.percentile(some[:, 2], [2, 98])
    colors = colorize(some[None, :, 2], float(low), float(high))[0, :, :3] / 255
    return Preview(points=some, colors=colors)


def _pictures(frames: FrameSet, chosen: list[int]) -> list[tuple[str, str]]:
    pictures = []
    for i in chosen:
        frame = frames.frames[i]
        color = frame.color()
        if color is not None:
            pictures.append((f"{frame.name}, colour", photo_uri(color, WIDTH)))
        depth = np.where(frame.depth() > 0, frame.depth(), np.nan)
        far = float(np.nanpercentile(depth, 95)) if np.isfinite(depth).any() else 1.0
        pictures.append((f"{frame.name}, depth to {far:.1f} m", photo_uri(colorize(depth, 0.0, far), WIDTH)))
    return pictures


def _spread(points: F64, triangles: NDArray[Any] | None) -> F64:
    """Points of a surface, by area; of a cloud, some of its own."""
    rng = np.random.default_rng(0)
    if triangles is None or not len(triangles):
        return points[rng.permutation(len(points))[:POINTS]]
    return sampled(points, triangles, POINTS, rng)[0]
