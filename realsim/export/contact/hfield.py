"""`hfield`: one height field. Cheap on the CPU and faithful on level ground; edges become ramps one cell wide, and
what overhangs is filled down to the ground."""

import numpy as np
from numpy.typing import NDArray

from realsim.core.meshes import used
from realsim.export.config import SceneConfig
from realsim.export.contact.base import Asset, ContactModel, Geom, floor_around
from realsim.export.contact.shape import Shape
from realsim.export.heights import HeightGrid, height_grid

BASE = 0.1  # metres of solid below the lowest node
MOST_NODES = 1_000_000  # that `auto` takes: 25 MB in a scene. Four times as many take 0.7 GB while they are measured
# Set for the memory of a made corridor of 35 x 21 m (1.83 to 1.41 GB); elsewhere not measured.


def hfield(shape: Shape, config: SceneConfig) -> ContactModel:
    """The mesh from above, on nodes `config.hfield_resolution` apart; where it has holes, the ground.

    MuJoCo shifts and scales the numbers of a height field to 0..1 when it compiles, and stretches them by the
    asset's elevation: the elevation therefore has to be exactly the range of the numbers in the file, and the geom
    stands at the lowest of them. The file is MuJoCo's own binary format, whose first row lies at the lowest y; an
    8-bit image would round a 1 m terrain to 4 mm steps and turn the rows round.
    """
    mesh, ground_z = shape.mesh, shape.ground_z
    plan = used(mesh.vertices, mesh.triangles)[:, :2]
    most = float(np.sqrt(np.ptp(plan, axis=0).prod() / MOST_NODES)) if config.contact == "auto" else 0.0
    grid = height_grid(mesh.vertices, mesh.triangles, max(config.hfield_resolution, most))
    holes = np.isnan(grid.z)
    z = np.where(holes, ground_z, grid.z).astype(np.float32)
    lowest, highest = float(z.min()), float(z.max())
    asset = Asset("terrain", "hfield", "terrain.hfield", hfield_bytes(z), hfield_size(grid, highest - lowest))
    centre = (grid.lower + grid.upper) / 2
    field = Geom("terrain", "hfield", (float(centre[0]), float(centre[1]), lowest), asset=asset.name)
    bounds = np.stack([grid.lower, grid.upper])
    statistics = {
        "cell_m": [float(s) for s in grid.spacing],
        "rows": int(z.shape[0]),
        "columns": int(z.shape[1]),
        "nodes_without_surface": int(holes.sum()),
    }
    share, warnings = float(holes.mean()), []
    if share > 0.15:
        warnings.append(f"{share:.0%} of the collision height field had no surface above it and was taken to be ground")
    if most > config.hfield_resolution:
        warnings.append(f"the cells of the collision height field are {100 * most:.1f} cm, for so large a terrain")
    return ContactModel("hfield", (field, *floor_around(bounds[None], ground_z)), (asset,), statistics, tuple(warnings))


def hfield_bytes(z: NDArray[np.float32]) -> bytes:
    """MuJoCo's height field file: int32 rows, int32 columns, then float32 heights row by row from the lowest y."""
    return np.array(z.shape, "<i4").tobytes() + np.ascontiguousarray(z, "<f4").tobytes()


def hfield_size(grid: HeightGrid, elevation: float) -> dict[str, str]:
    """The asset's `size`: half lengths along x and y, elevation of the highest node, depth of the base below it."""
    half = (grid.upper - grid.lower) / 2
    # A flat field is all zeros after MuJoCo's scaling; its elevation only has to be positive.
    numbers = (half[0], half[1], max(elevation, 1e-6), BASE)
    return {"size": " ".join(repr(float(n)) for n in numbers)}
