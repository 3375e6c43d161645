"""A mesh with its ground, and what several representations make of it: worked out once, when first asked for."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import across
from realsim.core.types import TerrainMesh
from realsim.export.contact.islands import PIT, Terrain, terrain
from realsim.export.contact.planar import PlanarIsland, planar

COARSE = 0.01  # metres
UPRIGHT = 0.5  # most |z| of a side face's normal
SHOULDER = 1.1  # metres above the ground up to which a robot meets side faces; rays from the side go up to 1 m
BEHIND = (0.5, 1.5)  # cells behind a side face at which its solid is looked for: a wall may be thin
HIDDEN = 0.001  # metres above the ground: what is lower is the ground


@dataclass(frozen=True, eq=False)
class Solids:
    """Convex pieces that a mesh is made of, and what is left of it."""

    corners: tuple[NDArray[np.float64], ...]
    """[(M, 3)] of each piece, metres."""
    rest: TerrainMesh | None
    """The mesh without them; None where nothing is left."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Input of collision representations."""

    mesh: TerrainMesh
    ground_z: float
    """z of the ground, metres."""
    pieces: Solids | None = None
    """Convex pieces of the mesh that need no fitting, if it has some."""

    @cached_property
    def solids(self) -> tuple[NDArray[np.float64], ...]:
        """[(M, 3)] corners of those pieces that rise from the ground.

        None where the ground has pits: their walls are made of the whole mesh.
        """
        if self.pieces is None or not self.pieces.corners or (self.pieces.rest is not None and self._dug):
            return ()
        least = -np.inf if self._dug else self.ground_z + HIDDEN
        return tuple(points for points in self.pieces.corners if points[:, 2].max() > least)

    @cached_property
    def _dug(self) -> bool:
        """Whether there are pits in the ground."""
        lowest = float(self.mesh.vertices[self.mesh.triangles][..., 2].min())
        return lowest < self.ground_z - PIT and terrain(self.mesh, self.ground_z).floor[0].type != "plane"

    @cached_property
    def fine(self) -> Terrain:
        """Columns of 5 mm of what is not in `solids`: for planes and outlines."""
        return self._rest(self._whole)

    @cached_property
    def _whole(self) -> Terrain:
        return terrain(self._left, self.ground_z)

    @cached_property
    def coarse(self) -> Terrain:
        """Columns of 1 cm of the same: for closed solids."""
        return self._rest(terrain(self._left, self.ground_z, COARSE))

    def sides_in_columns(self, noise: float = 0.0) -> float:
        """Share of the measured side faces, up to SHOULDER above the ground, that have a solid column behind them.

        A wall that was seen from one side has no top and no underside, so that no column knows it.

        Args:
            noise: metres that the surface is off: columns within twice that behind a wall go in and out of it.
        """
        mesh = self._left
        cross, middle = across(mesh.vertices, mesh.seen), mesh.vertices[mesh.seen].mean(1)
        area = np.linalg.norm(cross, axis=1)
        over = middle[:, 2] - self.ground_z
        side = (np.abs(cross[:, 2]) < UPRIGHT * area) & (over > PIT) & (over < SHOULDER)
        if not side.any():
            return 1.0
        cross, area, middle = cross[side], area[side], middle[side]
        grid = self._whole.grid
        inward = -cross[:, :2] / np.maximum(np.linalg.norm(cross[:, :2], axis=1, keepdims=True), 1e-15)
        rows, columns = grid.top.shape[1:]
        solid = np.zeros(len(middle), bool)
        for far in BEHIND:
            column, row = (
                np.rint((middle[:, :2] + (far * grid.cell + 2 * noise) * inward - grid.lower) / grid.cell).astype(int).T
            )
            known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            row, column, z = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1), middle[:, 2]
            solid |= known & ((grid.top[:, row, column] > z) & (grid.bottom[:, row, column] < z)).any(0)
        return float(area[solid].sum() / area.sum())

    @property
    def _left(self) -> TerrainMesh:
        whole = not self.solids or self.pieces is None or self.pieces.rest is None
        return self.mesh if whole else self.pieces.rest  # type: ignore[union-attr,return-value]

    def _rest(self, made: Terrain) -> Terrain:
        nothing = self.solids and self.pieces is not None and self.pieces.rest is None
        return replace(made, islands=()) if nothing else made

    @cached_property
    def planar(self) -> tuple[PlanarIsland, ...]:
        """Prisms of every island of `fine`."""
        return tuple(self.planar_of(n) for n in range(len(self.fine.islands)))

    @property
    def curved(self) -> bool:
        """Whether a part of it is not made of planes."""
        return any(np.isinf(found.misfit) for found in self.planar)

    def planar_of(self, n: int) -> PlanarIsland:
        """Those of one island."""
        if n not in self._planar:
            self._planar[n] = planar(self.fine, self.fine.islands[n])
        return self._planar[n]

    @cached_property
    def _planar(self) -> dict[int, PlanarIsland]:
        return {}
