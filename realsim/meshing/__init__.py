"""Surface of an aligned scene: fusion, reconstruction, trimming, clean-up, decimation, quality."""

from __future__ import annotations

from typing import TYPE_CHECKING

from realsim.meshing.config import METHODS, MeshConfig

if TYPE_CHECKING:
    from realsim.core.types import AlignedScene, MeshQuality, TerrainMesh
    from realsim.meshing.surface import Surface


def build(aligned: AlignedScene, config: MeshConfig) -> TerrainMesh:
    """The terrain's surface in the simulation frame; see `realsim.meshing.build_mesh`."""
    from realsim.meshing.build_mesh import build

    return build(aligned, config)


def solid(mesh: TerrainMesh, aligned: AlignedScene, cell: float | None = None) -> Surface:
    """The terrain as one closed manifold; see `realsim.meshing.solids.solid`."""
    from realsim.meshing.solids import solid

    return solid(mesh, aligned, cell)


def check(surface: Surface) -> MeshQuality:
    """Quality of any surface; see `realsim.meshing.quality.check`."""
    from realsim.meshing.quality import check

    return check(surface)


__all__ = ["METHODS", "MeshConfig", "build", "check", "solid"]
