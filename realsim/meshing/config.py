"""What can be set about the surface."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MeshConfig:
    method: str = "poisson"
    """Surface reconstruction: `poisson` (screened) or `tsdf`."""
    resolution: float | None = None
    """Metres a cell; chosen from the data's noise if not given."""
    max_triangles: int = 200_000
    """Decimate to at most this many."""
    max_error: float = 0.002
    """Metres that decimation may move the surface."""
    seed: int = 0
