"""What can be set about the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro


@dataclass(frozen=True)
class MeshConfig:
    method: Annotated[str, tyro.conf.arg(name="mesh-method")] = "poisson"
    """Surface reconstruction: `poisson` (screened) or `tsdf`."""
    resolution: float | None = None
    """Metres a cell; chosen from the data's noise if not given."""
    max_triangles: int = 200_000
    """Decimate to at most this many."""
    max_error: float = 0.002
    """Metres that decimation may move the surface."""
    seed: Annotated[int, tyro.conf.Suppress] = 0
