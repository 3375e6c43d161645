"""Options of the surface."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from realsim.core.limits import check_limits
from realsim.core.registry import Registry

METHODS = Registry(
    "mesh method",
    {
        "poisson": "realsim.meshing.methods:poisson",
        "tsdf": "realsim.meshing.methods:tsdf",
    },
)
"""Name -> (AlignedScene, Evidence) -> Surface."""


@dataclass(frozen=True)
class MeshConfig:
    method: Annotated[str, tyro.conf.arg(name="mesh-method", metavar="{poisson,tsdf}")] = "poisson"
    """Surface reconstruction: `poisson` (screened) or `tsdf`."""
    resolution: float | None = None
    """Cell size in metres; by default chosen from the noise of the data."""
    max_triangles: int = 200_000
    """Decimate to at most this many triangles, as far as --max-error allows."""
    max_error: float = 0.002
    """Largest displacement of the surface by decimation, metres."""
    min_views: int = 1
    """Number of views that must have measured a point of the surface."""
    min_island: float = 0.01
    """Square metres; smaller free-hanging pieces are removed."""
    close: bool = True
    """Add walls from unseen edges down to the surface below, for collisions; they are never part of mesh.ply."""
    residual_views: int = 6
    """Views whose residuals go into the report."""
    seed: Annotated[int, tyro.conf.Suppress] = 0

    def __post_init__(self) -> None:
        check_limits(
            self,
            above={"max_error": 0},
            least={"resolution": 0.001, "max_triangles": 100, "min_views": 1, "min_island": 0, "residual_views": 0},
            most={"resolution": 0.2, "max_error": 0.1},
        )
