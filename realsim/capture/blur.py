"""How wide the edges of a picture are, in pixels: an absolute measure of blur, without another picture beside it.

Along a line through the picture an edge is a run of values that only rise or only fall; its width is its height over
its steepest step (the idea of Marziliano et al., A no-reference perceptual blur metric, ICIP 2002). Every picture has
soft edges too, of shadows and round things: the sharpest fifth tells what lens, sensor and motion let through. Motion
widens edges along one direction only, hence the worst of four directions counts.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from realsim.core.types import F32, F64

SMEARED = 4.0
"""Pixels from which the sharpest edges of a picture are blurred. Set on pictures of 640x480: as they are, those of a
rendered capture (stake_a), a RealSense (boxes) and a Kinect (slambook) have 2.0 to 3.3; smeared over 9 pixels 4.3 to
7.2. Not used for setting: two rendered captures and an iPhone's have 1.4 to 3.4 as they are; smeared over 9 of 640
pixels, the rendered ones have 3.9 to 6.6."""
CONTRAST = 24.0
"""Grey levels that an edge must span: noise has no such edges."""
LINES = 120
"""About this many lines along the shorter side are looked at."""
MIDDLE = 800
"""Of larger pictures this many pixels in the middle are looked at: a phone's would take a fifth of a second."""
LEAST = 30
"""Edges that a direction needs; dark pictures have few. Not set on any data. 12 pictures of narrow_a and mixed_a, in
four lights, sharp and smeared over 9 and 15 pixels: without it 15 of 75 verdicts are wrong, with it 4 of 51, and the
rest get none. 10 of a RealSense: 19 of 84 without, 12 of 62 with it. From 60 on also sharp pictures in good light get
none."""
SHARPEST = 20
"""Percentile of the widths that counts."""


def edge_width(gray: NDArray) -> float | None:
    """Pixels; of a picture (h, w) of 0..255. None if no direction has enough edges (plain walls, dark pictures)."""
    h, w = gray.shape
    top, left = max(0, h - MIDDLE) // 2, max(0, w - MIDDLE) // 2
    gray = gray[top : top + MIDDLE, left : left + MIDDLE]
    step = max(1, min(gray.shape) // LINES)
    found = []
    for lines, pixels in _lines(gray.astype(np.float32), step):
        widths = _widths(lines)
        if len(widths) >= LEAST:
            found.append(pixels * float(np.percentile(widths, SHARPEST)))
    return max(found) if found else None


def _lines(gray: F32, step: int) -> Iterator[tuple[F32, float]]:
    """Every `step`-th line in four directions as rows, NaN outside the picture, and the pixels from value to value.

    Three neighbouring lines are averaged, which halves the noise and widens no edge that runs across them.
    """
    import cv2

    yield np.asarray(cv2.blur(gray, (1, 3)), np.float32)[::step], 1.0
    yield np.asarray(cv2.blur(gray, (3, 1)), np.float32)[:, ::step].T, 1.0
    across = np.ascontiguousarray(np.eye(3, dtype=np.float32)[:, ::-1] / 3)
    for picture in (gray, np.ascontiguousarray(gray[:, ::-1])):
        smooth = np.asarray(cv2.filter2D(picture, cv2.CV_32F, across), np.float32)
        h, w = smooth.shape
        # Row r moved to the right by h - r: what was a diagonal is a column.
        skewed = np.full((h, w + h + 1), np.nan, np.float32)
        skewed[:, h : h + w] = smooth
        diagonals = np.append(skewed.ravel(), np.full(h, np.nan, np.float32)).reshape(h, w + h + 2)
        yield diagonals[:, ::step].T, float(np.sqrt(2))


def _widths(lines: F32) -> F64:
    """(K,) widths of the edges along rows, in values."""
    steps = np.diff(lines, axis=1, append=np.nan).ravel()
    steps = np.where(np.isfinite(steps), steps, 0)
    sign = np.sign(steps)
    first = np.flatnonzero(np.concatenate([[True], sign[1:] != sign[:-1]]))
    height = np.abs(np.add.reduceat(steps, first)).astype(float)
    steepest = np.maximum.reduceat(np.abs(steps), first)
    edge = height > CONTRAST
    return height[edge] / steepest[edge]
