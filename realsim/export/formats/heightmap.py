"""Height map: npz with metres, and a 16-bit PNG with the numbers that turn it back into metres."""

import io
from pathlib import Path

import numpy as np

from realsim.core.files import to_json, write_bytes, write_text
from realsim.export.formats.scene import SceneOnDisk
from realsim.export.heights import height_grid
from realsim.export.visual import png_bytes

RESOLUTION = 0.02  # metres between nodes
UNSEEN = 65535  # PNG value where nothing was seen


def heightmap(scene: SceneOnDisk, folder: Path) -> list[Path]:
    """heightmap.npz (`z` (rows, columns) metres float32, NaN unseen; `lower` x y of node [0, 0]; `spacing` along x
    and y), heightmap.png (first row at the highest y, as images are looked at) and heightmap.json."""
    grid = height_grid(scene.vertices, scene.triangles, RESOLUTION)
    lowest, highest = float(np.nanmin(grid.z)), float(np.nanmax(grid.z))
    step = max((highest - lowest) / (UNSEEN - 1), 1e-9)
    image = np.where(np.isnan(grid.z), UNSEEN, np.rint((np.nan_to_num(grid.z) - lowest) / step)).astype(np.uint16)
    arrays = io.BytesIO()
    np.savez_compressed(arrays, z=grid.z.astype(np.float32), lower=grid.lower, spacing=grid.spacing)
    write_bytes(folder / "heightmap.npz", arrays.getvalue())
    write_bytes(folder / "heightmap.png", png_bytes(image[::-1]))
    metadata = {
        "metres": "z = offset + step * value",
        "offset_m": lowest,
        "step_m": step,
        "unseen": UNSEEN,
        "spacing_m": grid.spacing,
        "x_of_first_column": grid.lower[0],
        "y_of_last_row": grid.lower[1],
        "first_row": "highest y",
    }
    write_text(folder / "heightmap.json", to_json(metadata))
    return [folder / f"heightmap.{end}" for end in ("npz", "png", "json")]
