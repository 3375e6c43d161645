"""Separates the terrain from surface that is cut away."""

import numpy as np

from realsim.align.cloud import Cloud
from realsim.align.segment import Label, Labels
from realsim.core.meshes import groups
from realsim.core.types import F64, Platform

REACH = 0.35
"""Metres: an obstacle this close to the terrain is part of it (a robot's stride)."""
CELL = 0.06
SOLID = 0.55
"""Share of a cell's voxels (seen from above) that something solid fills; flying pixels behind an edge are fewer."""
LEAST = 0.008
"""Square metres of voxels that make an object."""
HEADROOM, DEPTH = 0.15, 0.10
"""Metres kept above the highest part of the terrain and below the ground."""


def crop(
    cloud: Cloud, labels: Labels, platforms: tuple[Platform, ...], ground_z: float, margin: float
) -> tuple[F64, list[str]]:
    """Bounds (2, 3) of what is kept, and in words what is not. All in the simulation frame.

    The terrain is the box about start, goal and the treads between them, grown by every obstacle or platform within a
    stride of it until nothing more is near; then the margin of ground. Without these, the terrain is all that stands
    low on the ground (all ground, if nothing stands there).
    """
    from scipy.ndimage import label

    standing = (labels == Label.OBSTACLE) | (labels == Label.PLATFORM)
    xy = cloud.points[:, :2]
    clusters: list[F64] = []
    if standing.any():
        origin = xy[standing].min(0)
        cell = max(CELL, 2 * cloud.voxel)
        cells = np.floor((xy[standing] - origin) / cell).astype(int)
        count = np.zeros(cells.max(0) + 1, int)
        np.add.at(count, tuple(cells.T), 1)
        ids = label(count >= round(SOLID * (cell / cloud.voxel) ** 2), np.ones((3, 3)))[0][tuple(cells.T)]
        parts = [part for part in groups(ids) if ids[part[0]] > 0 and len(part) * cloud.voxel**2 >= LEAST]
        clusters = [xy[standing][part] for part in parts]
    chosen = [p for p in platforms if p.role in ("start", "goal") or p.inferred]
    if chosen:
        outline = np.concatenate([p.outline for p in chosen])
        low, high, left = _grown(outline.min(0), outline.max(0), clusters)
    else:
        ground = xy[labels == Label.GROUND]
        everything = np.concatenate(clusters) if clusters else ground
        low, high, left = everything.min(0), everything.max(0), []
    kept = standing & (xy >= low - REACH).all(1) & (xy <= high + REACH).all(1)
    top = float(cloud.points[kept, 2].max()) if kept.any() else ground_z
    top = max([top, *(float(p.centroid[2]) for p in chosen)])  # the last tread of a flight is higher than obstacles are
    bounds = np.array([[*(low - margin), ground_z - DEPTH], [*(high + margin), top + HEADROOM]])
    return bounds, _describe_cropped(cloud, labels, bounds, left, margin)


def everything(cloud: Cloud) -> F64:
    """Bounds (2, 3) of all that was seen, a few voxels wider."""
    slack = 3 * cloud.voxel
    return np.stack([cloud.points.min(0) - slack, cloud.points.max(0) + slack])


def _grown(low: F64, high: F64, clusters: list[F64]) -> tuple[F64, F64, list[F64]]:
    """The box grown by near clusters, and the clusters that stay outside."""
    left = clusters
    while True:
        near = [bool(((c > low - REACH) & (c < high + REACH)).all(1).any()) for c in left]
        if not any(near):
            return low, high, left
        for cluster, is_near in zip(left, near, strict=True):
            if is_near:
                low, high = np.minimum(low, cluster.min(0)), np.maximum(high, cluster.max(0))
        left = [c for c, is_near in zip(left, near, strict=True) if not is_near]


def _describe_cropped(cloud: Cloud, labels: Labels, bounds: F64, left: list[F64], margin: float) -> list[str]:
    outside = ((cloud.points < bounds[0]) | (cloud.points > bounds[1])).any(1)
    lines = []
    share = float(np.mean(outside[labels == Label.GROUND])) if (labels == Label.GROUND).any() else 0.0
    if share > 0.005:
        far = f"further than {margin:g} m from the terrain (--keep all keeps it)"
        lines.append(f"{100 * share:.0f} percent of the seen ground, {far}")
    for cluster in left:
        centre, extent = cluster.mean(0), np.ptp(cluster, axis=0) + cloud.voxel
        lines.append(
            f"an object of {extent[0]:.1f} x {extent[1]:.1f} m at x {centre[0]:.1f}, y {centre[1]:.1f} m, "
            "away from the terrain"
        )
    other = int(np.count_nonzero(outside & (labels == Label.OTHER)))
    if other:
        lines.append(f"{other} voxels of walls, people, or noise outside the terrain")
    return lines
