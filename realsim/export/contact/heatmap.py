"""The error map of a representation as a picture."""

import numpy as np

from realsim.core.geometry import error_grid
from realsim.core.types import F64

LIMIT = 0.015  # metres at which a colour is full
NONE, GOOD, PHANTOM, MISSING = (235, 235, 235), (247, 247, 247), (178, 24, 43), (33, 102, 172)  # RGB


def heatmap_png(contact_map: F64, pixels: int = 6) -> bytes:
    """PNG of (N, 3) x, y, signed error in metres: red where MuJoCo touches what is not there, blue
    where it lacks what is there, white where both agree, full colour at 15 mm. x to the right, y up."""
    import cv2

    error = error_grid(contact_map)[..., None]
    strength = np.clip(np.abs(error) / LIMIT, 0, 1)
    color = np.array(GOOD) * (1 - strength) + np.where(error > 0, PHANTOM, MISSING) * strength
    image = np.where(np.isnan(error), NONE, np.rint(color)).astype(np.uint8)[..., ::-1]  # OpenCV wants blue first
    _, data = cv2.imencode(".png", image.repeat(pixels, 0).repeat(pixels, 1))
    return data.tobytes()
