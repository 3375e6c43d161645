"""Closed volume from an open surface: what is under a seen face is solid, unless a camera looked through it."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.errors import MeshError
from realsim.core.types import F64, AlignedScene, Bool, TerrainMesh
from realsim.meshing.clean import tidy, weld
from realsim.meshing.evidence import Evidence
from realsim.meshing.surface import Surface
from realsim.meshing.visibility import seen_through, votes

SKIRT = 0.10
"""Metres of ground below the lowest surface."""
CRUMB = 5e-4
"""Cubic metres; smaller solids that float free are noise."""


def solid(mesh: TerrainMesh, aligned: AlignedScene, cell: float | None = None) -> Surface:
    """A closed manifold around the terrain: seen and invented surface, sides at the bounds, a bottom below the ground.

    Args:
        cell: metres of the grid that it is drawn on; the mesh's resolution if None.

    Raises:
        MeshError: no closed manifold came of it.
    """
    import manifold3d

    surface = Surface(mesh.vertices, mesh.triangles)
    cell = cell or mesh.resolution
    grid = Columns(surface, aligned.bounds, aligned.ground_z, cell)
    occupied = grid.without_curtains(surface) if mesh.invented.any() else grid.occupied
    closed = grid.surface(occupied, surface)
    body = manifold3d.Manifold(
        manifold3d.Mesh64(vert_properties=closed.vertices, tri_verts=closed.triangles.astype(np.uint64))
    )
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        raise MeshError("the surface cannot be closed", found=str(body.status()), hint="try a coarser cell")
    return closed


def invent(seen: Surface, aligned: AlignedScene, evidence: Evidence | None, cell: float) -> Surface:
    """The surface that physics needs and nobody saw: far sides, undersides of what has a gap below, hidden ground.

    Space under a seen face counts as solid down to the next surface or the ground, except where at least two cameras
    looked through it. Space with nothing seen above counts as empty.

    Args:
        cell: metres of the grid; this surface is only as fine as that.
    """
    grid = Columns(seen, aligned.bounds, aligned.ground_z, cell)
    occupied = grid.occupied
    if evidence is not None and evidence.maps:
        inner = np.argwhere(occupied & (grid.axes[2] > aligned.ground_z + cell)[None, None, :])
        empty = seen_through(*votes(grid.places(inner), list(evidence.maps), evidence.sigma, cell))
        occupied = grid.carved(occupied, inner[empty])
    closed = grid.surface(occupied, seen)
    centre = closed.centres()
    inside = ((centre[:, :2] > aligned.bounds[0, :2] + cell) & (centre[:, :2] < aligned.bounds[1, :2] - cell)).all(1)
    inside &= centre[:, 2] > aligned.ground_z - 0.5 * SKIRT
    # A triangle that runs along the seen surface repeats it; only what leaves it is new.
    return closed.where(inside & (seen.distance(centre) > 0.75 * cell))


def inferred_tops(seen: Surface, aligned: AlignedScene, cell: float) -> Surface:
    """The tops of inferred platforms where no seen surface is, in triangles of about `cell` metres."""
    tops = Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    for p in aligned.platforms:
        if p.inferred:
            corners = np.column_stack([p.outline, np.full(len(p.outline), p.centroid[2])])
            parts = np.stack([np.stack([corners[0], corners[k], corners[k + 1]]) for k in range(1, len(corners) - 1)])
            while np.linalg.norm(parts - np.roll(parts, 1, 1), axis=2).max() > cell:
                half = (parts + np.roll(parts, -1, 1)) / 2  # each triangle in quarters
                inner = [np.stack([parts[:, k], half[:, k], half[:, k - 1]], 1) for k in range(3)]
                parts = np.concatenate([*inner, half])
            fine = Surface(parts.reshape(-1, 3), np.arange(3 * len(parts), dtype=np.int32).reshape(-1, 3))
            tops = tops.joined(fine.where(seen.distance(fine.centres()) > 0.5 * cell))
    return tidy(weld(tops, 1e-5)) if len(tops.triangles) else tops


class Columns:
    """A regular grid over the bounds, one vertical ray a column."""

    def __init__(self, surface: Surface, bounds: F64, ground_z: float, cell: float) -> None:
        self.cell, self.ground_z = cell, ground_z
        low = min(ground_z, float(surface.vertices[:, 2].min())) - SKIRT
        high = float(max(surface.vertices[:, 2].max(), ground_z)) + 2 * cell
        self.lower, upper = np.array([*bounds[0, :2], low]), np.array([*bounds[1, :2], high])
        count = np.ceil((upper - self.lower) / cell).astype(int) + 1
        if np.prod(count.astype(float)) > 2e8:
            raise MeshError("the grid is too fine for the scene", found=f"{cell} m", hint="use a coarser cell")
        self.axes = tuple(self.lower[k] + cell * np.arange(count[k]) for k in range(3))
        self.occupied, self.hit = self._cast(surface)

    def places(self, nodes: NDArray[np.int64]) -> F64:
        """(M, 3) metres of nodes (M, 3)."""
        return self.lower + self.cell * nodes

    def _cast(self, surface: Surface) -> tuple[Bool, Bool]:
        """Two (nx, ny, nz): nodes that are solid, and nodes with a surface between them and the next one above.

        Solid is what the nearest surface above covers from above, and what lies below the ground.
        """
        x, y, z = self.axes
        X, Y = np.meshgrid(x, y, indexing="ij")
        top = z[-1] + 1.0
        above = np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, top)])
        ray, t, triangle = surface.rays().crossings(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape))
        height = top - t
        up = surface.crosses()[triangle, 2] > 0

        # A hit changes what is below it; the lowest hit above a node decides. Later (lower) writes win.
        state = np.full((X.size, len(z)), -1, np.int8)
        level = np.clip(np.ceil((height - z[0]) / self.cell).astype(np.int64) - 1, -1, len(z) - 1)
        valid = level >= 0
        hit = np.zeros((X.size, len(z)), bool)
        hit[ray[valid], level[valid]] = True
        order = np.lexsort((-height[valid], ray[valid]))
        state[ray[valid][order], level[valid][order]] = up[valid][order]
        for k in range(len(z) - 2, -1, -1):
            state[:, k] = np.where(state[:, k] < 0, state[:, k + 1], state[:, k])
        # Without any surface above, the ground is where it is everywhere else.
        filled = (state == 1) | ((state < 0) & (z < self.ground_z)[None, :])
        # A surface below the ground plane is sensor noise or a hollow; nothing is empty beneath it.
        filled[:, z < self.ground_z - 0.5 * SKIRT] = True
        shape = (len(x), len(y), len(z))
        return without_crumbs(filled.reshape(shape), self.cell), hit.reshape(shape)

    def carved(self, occupied: Bool, empty: NDArray[np.int64]) -> Bool:
        """Without the nodes (M, 3) that cameras looked through, and without what hangs beneath those unmeasured.

        Looking through needs a clear distance to what is behind, so that the last centimetres above a floor are never
        seen through; without a surface in between they are as empty as what is above them.
        """
        occupied = occupied.copy()
        free = np.zeros_like(occupied)
        free[tuple(empty.T)] = True
        for k in range(occupied.shape[2] - 2, -1, -1):
            if self.axes[2][k] <= self.ground_z:
                break
            free[:, :, k] |= free[:, :, k + 1] & ~self.hit[:, :, k] & occupied[:, :, k]
        return without_crumbs(occupied & ~free, self.cell)

    def without_curtains(self, surface: Surface) -> Bool:
        """Occupied nodes without the curtains that hang where a closing surface has a slit.

        Such a curtain is thinner than five cells and has no surface along it; a real thin wall has.
        """
        from scipy import ndimage

        above = self.occupied & (self.axes[2] > self.ground_z + self.cell)[None, None, :]
        index = np.argwhere(above)
        if len(index) == 0:
            return self.occupied
        points = np.stack([self.axes[k][index[:, k]] for k in range(3)], -1)
        away = index[surface.distance(points) > 1.2 * self.cell]
        thick = ndimage.binary_opening(self.occupied, np.ones((5, 5, 1), bool))
        curtain = np.zeros_like(above)
        curtain[tuple(away.T)] = True
        curtain &= ~thick
        return without_crumbs(self.occupied & ~curtain, self.cell)

    def surface(self, occupied: Bool, near: Surface) -> Surface:
        """The closed border of the occupied nodes; where `near` runs within two cells, exactly along it."""
        from scipy import ndimage
        from skimage.measure import marching_cubes

        field: NDArray[np.float32] = np.where(occupied, -1.0, 1.0).astype(np.float32)
        # Unseen walls: soften the steps of the grid. Seen ones: replace by the true distance.
        field = ndimage.gaussian_filter(field, 0.7)
        field = np.where(np.sign(field) == np.where(occupied, -1, 1), field, np.where(occupied, -0.05, 0.05))
        band = ndimage.binary_dilation(occupied, iterations=2) & ~ndimage.binary_erosion(occupied, iterations=2)
        index = np.argwhere(band)
        distance = near.distance(self.places(index)) / self.cell
        close = distance < 1.0
        sign = np.where(occupied[tuple(index.T)], -1.0, 1.0)
        field[tuple(index[close].T)] = (sign * np.maximum(distance, 1e-3))[close]
        padded = np.pad(field, 1, constant_values=1.0)
        vertices, triangles, _, _ = marching_cubes(padded, 0.0, gradient_direction="descent")
        return tidy(Surface((vertices - 1.0) * self.cell + self.lower, triangles.astype(np.int32)))


def without_crumbs(occupied: Bool, cell: float) -> Bool:
    """Without enclosed bubbles, and without pieces smaller than CRUMB that touch nothing."""
    from scipy import ndimage

    occupied = ndimage.binary_fill_holes(occupied)
    label, n = ndimage.label(occupied)
    if n > 1:
        volume = np.bincount(label.ravel()) * cell**3
        volume[0] = 0
        occupied = (volume >= CRUMB)[label]
    return np.asarray(occupied, bool)
