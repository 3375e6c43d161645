"""Heights of a mesh on a regular grid, seen from straight above."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import ExportError
from realsim.core.rays import Rays

MAX_NODES = 16_000_000


@dataclass(frozen=True)
class HeightGrid:
    """Node heights on a grid parallel to x and y."""

    lower: NDArray[np.float64]
    """(2,) x y of node [0, 0], metres."""
    spacing: NDArray[np.float64]
    """(2,) metres between nodes along x and y."""
    z: NDArray[np.float64]
    """(rows, columns) heights: row i at y = lower[1] + i spacing[1], column j at x = lower[0] + j spacing[0]. NaN
    where nothing lies below."""

    @property
    def upper(self) -> NDArray[np.float64]:
        """(2,) x y of the last node."""
        rows, columns = self.z.shape
        return self.lower + self.spacing * (columns - 1, rows - 1)


def height_grid(vertices: NDArray[np.float64], triangles: NDArray[np.int32], resolution: float) -> HeightGrid:
    """A mesh from above on a grid of at most `resolution` metres spacing that spans its bounding box exactly."""
    if len(triangles) == 0:
        raise ExportError("the mesh has no triangles")
    surface = Rays(vertices, triangles)
    extent = (surface.upper - surface.lower)[:2]
    cells = np.maximum(np.ceil(extent / resolution - 1e-9).astype(int), 1)
    if np.prod(cells + 1.0) > MAX_NODES:
        raise ExportError(
            "the height field would be too large",
            expected=f"at most {MAX_NODES} nodes",
            found=f"{cells[0] + 1} x {cells[1] + 1} for {extent[0]:.1f} x {extent[1]:.1f} m",
            hint="choose a larger --hfield-resolution, or check the mesh's unit",
        )
    columns, rows = cells + 1
    x = np.linspace(surface.lower[0], surface.upper[0], columns)
    y = np.linspace(surface.lower[1], surface.upper[1], rows)
    # Rays exactly on the border may miss the border's triangles by rounding: look a hair inside.
    hair = 1e-6 * np.maximum(extent, 1e-3)
    gx, gy = np.meshgrid(np.clip(x, x[0] + hair[0], x[-1] - hair[0]), np.clip(y, y[0] + hair[1], y[-1] - hair[1]))
    z = surface.height(np.column_stack([gx.ravel(), gy.ravel()])).reshape(rows, columns)
    return HeightGrid(surface.lower[:2].copy(), extent / cells, z)
