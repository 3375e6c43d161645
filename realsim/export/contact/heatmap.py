"""The error map of a representation as a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LIMIT = 0.015  # metres at which a colour is full
NONE, GOOD, PHANTOM, MISSING = (235, 235, 235), (247, 247, 247), (178, 24, 43), (33, 102, 172)  # RGB


def heatmap_png(contact_map: NDArray[np.float64], pixels: int = 6) -> bytes:
    """PNG of (N, 3) x, y, signed error in metres: red where MuJoCo touches what is not there, blue
    where it lacks what is there, white where both agree, full colour at 15 mm. x to the right, y up."""
    import cv2

    xy, error = contact_map[:, :2], contact_map[:, 2]
    lower, size = xy.min(0), np.maximum(np.ptp(xy, axis=0), 1e-6)
    cell = float(np.sqrt(size.prod() / len(xy))) * 1.15  # a little wider than the probes are apart: no empty rows
    column, row = ((xy - lower) / cell).astype(int).T
    image = np.full((row.max() + 1, column.max() + 1, 3), NONE, np.uint8)
    strength = np.clip(np.abs(np.nan_to_num(error)) / LIMIT, 0, 1)[:, None]
    full = np.where(np.nan_to_num(error)[:, None] > 0, PHANTOM, MISSING)
    color = np.array(GOOD) * (1 - strength) + full * strength
    order = np.argsort(np.abs(np.nan_to_num(error)), kind="stable")  # of several in a pixel, the worst is seen
    order = order[np.isfinite(error[order])]
    image[row[order], column[order]] = np.rint(color[order]).astype(np.uint8)
    image = image[::-1, :, ::-1].repeat(pixels, 0).repeat(pixels, 1)  # OpenCV wants blue first
    _, data = cv2.imencode(".png", image)
    return data.tobytes()
