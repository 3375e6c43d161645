"""The error map of a representation as a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LIMIT = 0.015  # metres at which a colour is full
NONE, GOOD, PHANTOM, MISSING = (235, 235, 235), (247, 247, 247), (178, 24, 43), (33, 102, 172)  # RGB


def heatmap_png(contact_map: NDArray[np.float64], pixels: int = 6) -> bytes:
    """PNG of (N, 3) x, y, signed error in metres on a square grid: red where MuJoCo touches what is not there, blue
    where it lacks what is there, white where both agree, full colour at 15 mm. x to the right, y up."""
    import cv2

    x, y, error = contact_map.T
    columns, rows = (np.unique(np.round(v, 6), return_inverse=True) for v in (x, y))
    shape = (len(rows[0]), len(columns[0]))
    image = np.full((*shape, 3), NONE, np.uint8)
    strength = np.clip(np.abs(np.nan_to_num(error)) / LIMIT, 0, 1)[:, None]
    full = np.where(np.nan_to_num(error)[:, None] > 0, PHANTOM, MISSING)
    color = np.array(GOOD) * (1 - strength) + full * strength
    known = np.isfinite(error)
    image[rows[1][known], columns[1][known]] = np.rint(color[known]).astype(np.uint8)
    image = np.kron(image[::-1], np.ones((pixels, pixels, 1), np.uint8))
    _, data = cv2.imencode(".png", image[..., ::-1])
    return data.tobytes()
