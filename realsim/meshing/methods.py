"""Surface methods: (aligned, evidence) -> measured surface."""

from __future__ import annotations

from realsim.core.types import AlignedScene
from realsim.meshing import poisson as poisson_solver
from realsim.meshing import tsdf as tsdf_solver
from realsim.meshing.evidence import Evidence
from realsim.meshing.surface import Surface
from realsim.meshing.trim import not_seen_through, supported


def poisson(aligned: AlignedScene, evidence: Evidence) -> Surface:
    """Screened Poisson of the fused points, trimmed to what was measured."""
    surface = poisson_solver.reconstruct(evidence.points, evidence.resolution)
    return _trimmed(surface, evidence)


def tsdf(aligned: AlignedScene, evidence: Evidence) -> Surface:
    """Signed distance fusion of the depth, trimmed to what was measured."""
    surface = tsdf_solver.reconstruct(aligned, evidence.resolution)
    return _trimmed(surface, evidence)


def _trimmed(surface: Surface, evidence: Evidence) -> Surface:
    surface = surface.where(supported(surface, evidence.points, evidence.resolution))
    keep = not_seen_through(surface, evidence.points, evidence.resolution, evidence.maps, evidence.sigma)
    return surface.where(keep)
