"""From an aligned scene to its surface."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from realsim.core.errors import MeshError
from realsim.core.types import AlignedScene, TerrainMesh
from realsim.meshing.clean import canonical, tidy, uncrossed
from realsim.meshing.config import METHODS, MeshConfig
from realsim.meshing.decimate import decimate
from realsim.meshing.evidence import Evidence, gather
from realsim.meshing.quality import check, residuals
from realsim.meshing.scan import surface_of_scan
from realsim.meshing.solids import inferred_tops, invent
from realsim.meshing.surface import Surface, colored_from, drop_islands
from realsim.meshing.unseen import unseen


def build(aligned: AlignedScene, config: MeshConfig) -> TerrainMesh:
    """The terrain's surface in the simulation frame.

    What was measured comes first in `triangles`; with `config.close`, invented walls, undersides and hidden ground
    follow, marked as such. `quality` is that of the measured surface. The same input gives the same bytes.

    Raises:
        MeshError: nothing to mesh inside the bounds, or an impossible resolution.
        UnknownNameError: `config.method` is not in `METHODS`.
    """
    method = METHODS[config.method]
    evidence: Evidence | None = None
    warnings: list[str] = []
    if aligned.scan is not None:
        surface, resolution, noise, name = surface_of_scan(aligned, config)
        statistics: dict[str, object] = {}
    else:
        evidence = gather(aligned, config.resolution, config.min_views)
        resolution, noise, name = evidence.resolution, evidence.noise, config.method
        surface = method(aligned, evidence)
        statistics = dict(evidence.statistics)
        warnings += evidence.warnings
    surface, islands = drop_islands(surface, config.min_island)
    surface = tidy(surface)
    if len(surface.triangles) == 0:
        raise MeshError("no surface is left inside the bounds", hint="look at the bounds and the poses in the report")

    full = surface
    reduced = decimate(full, config.max_triangles, config.max_error, config.seed)
    surface = uncrossed(reduced.surface)
    if evidence is not None:
        surface = colored_from(surface, evidence.points.points, evidence.points.colors)
    elif full.colors is not None:
        surface = colored_from(surface, full.vertices, full.colors)
    beside = ThreadPoolExecutor(1)  # measures the surface while it is being closed
    quality, distances = (
        beside.submit(check, surface),
        beside.submit(residuals, aligned, surface, config.residual_views),
    )
    beside.shutdown(wait=False)
    statistics |= {
        "islands_removed": islands,
        "triangles_before_decimation": len(full.triangles),
        "decimation_error_mm": 1e3 * reduced.error,
        # Where both cannot be had, the error bound holds and the count does not.
        "kept_for_error_bound": not reduced.within,
        "area_m2": float(surface.areas().sum()),
    }
    invented = Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    tops = invented
    if config.close:
        cell = max(0.015, resolution)
        tops = inferred_tops(surface, aligned, cell)
        known = surface.joined(tops) if len(tops.triangles) else surface
        invented = canonical(invent(known, aligned, evidence, cell)).joined(tops)
        statistics["invented_area_m2"] = float(invented.areas().sum())
        statistics["unseen"] = unseen(aligned, surface, invented, config.seed)
    whole, mask = _joined(surface, invented)
    inferred = np.arange(len(mask)) >= len(mask) - len(tops.triangles)
    return TerrainMesh(
        vertices=whole.vertices,
        triangles=whole.triangles,
        colors=whole.colors,
        invented=mask,
        quality=quality.result(),
        method=name,
        resolution=resolution,
        noise_m=noise,
        residuals=distances.result(),
        warnings=tuple(warnings),
        statistics=statistics,
        inferred=inferred if inferred.any() else None,
    )


def _joined(seen: Surface, invented: Surface) -> tuple[Surface, np.ndarray]:
    """Both in one, invented last, and which triangles are invented. Invented vertices are grey."""
    vertices = np.concatenate([seen.vertices, invented.vertices])
    triangles = np.concatenate([seen.triangles, invented.triangles + len(seen.vertices)]).astype(np.int32)
    colors = None
    if seen.colors is not None:
        colors = np.concatenate([seen.colors, np.full((len(invented.vertices), 3), 128, np.uint8)])
    mask = np.arange(len(triangles)) >= len(seen.triangles)
    return Surface(vertices, triangles, colors), mask
