"""A mesh with its ground, and what several representations make of it: worked out once, when first asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from realsim.core.types import TerrainMesh
from realsim.export.contact.islands import Terrain, terrain
from realsim.export.contact.planar import PlanarIsland, planar

COARSE = 0.01  # metres


@dataclass(frozen=True, eq=False)
class Shape:
    """Input of collision representations."""

    mesh: TerrainMesh
    ground_z: float
    """z of the ground, metres."""

    @cached_property
    def fine(self) -> Terrain:
        """Columns of 5 mm: for planes and outlines."""
        return terrain(self.mesh, self.ground_z)

    @cached_property
    def coarse(self) -> Terrain:
        """Columns of 1 cm: for closed solids."""
        return terrain(self.mesh, self.ground_z, COARSE)

    @cached_property
    def planar(self) -> tuple[PlanarIsland, ...]:
        """Prisms of every island of `fine`."""
        found = (planar(self.fine, island) for island in self.fine.islands)
        return tuple(replace(p, prisms=type(p.prisms)(q for q in p.prisms if not q.flat)) for p in found)
