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
    from scipy import ndimage

    xy, error = contact_map[:, :2], contact_map[:, 2]
    lower, size = xy.min(0), np.maximum(np.ptp(xy, axis=0), 1e-6)
    shape = np.maximum((size / np.sqrt(size.prod() / len(xy)) / 1.15).astype(int), 1)  # wider than probes are apart
    column, row = np.minimum((xy - lower) / size * shape, shape - 1).astype(int).T
    image = np.full((shape[1], shape[0], 3), NONE, np.uint8)
    strength = np.clip(np.abs(np.nan_to_num(error)) / LIMIT, 0, 1)[:, None]
    full = np.where(np.nan_to_num(error)[:, None] > 0, PHANTOM, MISSING)
    color = np.array(GOOD) * (1 - strength) + full * strength
    order = np.argsort(np.abs(np.nan_to_num(error)), kind="stable")  # of several in a pixel, the worst is seen
    order = order[np.isfinite(error[order])]
    image[row[order], column[order]] = np.rint(color[order]).astype(np.uint8)
    empty = np.ones(image.shape[:2], bool)
    empty[row, column] = False
    near = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    image = image[near[0], near[1]][::-1, :, ::-1]  # OpenCV wants blue first
    _, data = cv2.imencode(".png", image.repeat(pixels, 0).repeat(pixels, 1))
    return data.tobytes()
