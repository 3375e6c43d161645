"""Segmentation by geometry alone: heights, normals and what is connected to what."""

import numpy as np
from numpy.typing import NDArray

from realsim.align.cloud import Cloud
from realsim.align.faces import LEAST_AREA, LEVEL_DEG, cells_of, large, plane_of, smooth_regions
from realsim.align.segment import Label, Labels
from realsim.core.types import F64, Bool

GROUND_BAND = 0.03
"""Metres about z = 0 that are ground, where the cloud is no noisier than that."""
LEAST_RISE = 0.05
"""Metres: a cluster that nowhere rises higher is unevenness of the ground."""
LOWEST, HIGHEST = 0.08, 1.2
"""Metres: top faces outside this range of heights are no platforms."""
TALL = 1.5
"""Metres: what reaches higher is a wall, a person or furniture, not terrain."""
CLUSTER_CELL = 0.06
LEAST_OBSTACLE = 0.008
"""Square metres of voxels; less is noise."""


def segment(cloud: Cloud) -> Labels:
    """Labels of a levelled cloud (see `Segmenter`).

    Level faces are regions of neighbouring cells with smoothly varying height; those that are level and large are
    platforms. What else stands on the ground, lower than 1.5 m, is obstacle.
    """
    z, band = cloud.points[:, 2], ground_band(cloud)
    labels = np.full(len(cloud), Label.OTHER, np.uint8)
    labels[(np.abs(z) < band) & (np.abs(cloud.normals[:, 2]) > 0.7)] = Label.GROUND
    labels[_obstacles(cloud.points, band, cloud.voxel)] = Label.OBSTACLE
    for face in level_faces(cloud):
        labels[face] = Label.PLATFORM
    return labels


def level_faces(cloud: Cloud) -> list[NDArray[np.intp]]:
    """Indices of the points of each level face that is large enough to stand on, the largest first."""
    z = cloud.points[:, 2]
    up = cloud.normals[:, 2] if cloud.oriented else np.abs(cloud.normals[:, 2])
    candidates = np.flatnonzero((up > 0.9) & (z > LOWEST) & (z < HIGHEST))
    faces = []
    for region in smooth_regions(cloud.points[candidates], cloud.voxel, 0.5 * LEAST_AREA):
        points = cloud.points[candidates[region]]
        slope, height = plane_of(points)
        if np.degrees(np.arctan(np.hypot(*slope))) > LEVEL_DEG:
            continue
        residual = points[:, 2] - (points[:, :2] @ slope + height)
        band = float(np.clip(4 * 1.4826 * np.median(np.abs(residual)), 0.008, 0.02))
        # Normals bend at the rim, so the face is completed by height: all points of its plane near its region.
        on_plane = np.abs(z - (cloud.points[:, :2] @ slope + height)) < band
        face = np.flatnonzero(on_plane & _near(cloud.points[:, :2], points[:, :2], cloud.voxel))
        if large(cloud.points[face, :2], cloud.voxel):
            faces.append(face)
    return sorted(faces, key=lambda f: -len(f))


def ground_band(cloud: Cloud) -> F64:
    """(M,) metres about z = 0 within which a point is ground: wider for points that were only seen from afar.

    Their noise is taken from the cloud itself: deviation times sqrt(weight) is one number over all of a floor.
    """
    z = np.abs(cloud.points[:, 2])
    faint = (z < 0.10) & (cloud.weights <= np.median(cloud.weights))
    if faint.sum() < 50:
        return np.full(len(cloud), GROUND_BAND)
    unit = 1.4826 * float(np.median(z[faint] * np.sqrt(cloud.weights[faint])))
    return np.maximum(GROUND_BAND, 4 * unit / np.sqrt(cloud.weights))


def _obstacles(points: F64, band: F64, voxel: float) -> Bool:
    """Points of clusters that stand on the ground and are low; tall columns are taken out before clustering."""
    from scipy.ndimage import label

    out = np.zeros(len(points), bool)
    standing = np.flatnonzero((points[:, 2] > band) & (points[:, 2] < 4.0))
    if not len(standing):
        return out
    cells, shape = cells_of(points[standing, :2], max(CLUSTER_CELL, 2 * voxel))
    lowest, highest = np.full(shape, np.inf), np.full(shape, -np.inf)
    np.minimum.at(lowest, tuple(cells.T), points[standing, 2])
    np.maximum.at(highest, tuple(cells.T), points[standing, 2])
    clusters, _ = label((highest > -np.inf) & (highest < TALL), np.ones((3, 3)))
    floor_gap = np.full(clusters.max() + 1, np.inf)
    np.minimum.at(floor_gap, clusters.ravel(), lowest.ravel())
    member = clusters[tuple(cells.T)]
    rise = np.zeros(clusters.max() + 1)
    np.maximum.at(rise, clusters.ravel(), highest.ravel())
    size = np.bincount(member, minlength=len(rise))
    solid = size * voxel**2 >= LEAST_OBSTACLE
    out[standing] = (member > 0) & ((floor_gap < 0.3) & (rise > LEAST_RISE) & solid)[member]
    return out


def _near(xy: F64, region: F64, size: float, distance: float = 0.05) -> Bool:
    """Which points lie within `distance` of a region of points (on a grid of cells of `size`)."""
    from scipy.ndimage import binary_dilation

    low = region.min(0) - 2 * distance
    shape = np.ceil((region.max(0) + 2 * distance - low) / size).astype(int) + 1
    grid = np.zeros(shape, bool)
    grid[tuple(((region - low) / size).astype(int).T)] = True
    grid = binary_dilation(grid, np.ones((3, 3)), iterations=max(1, round(distance / size)))
    cell = np.floor((xy - low) / size).astype(int)
    inside = ((cell >= 0) & (cell < shape)).all(1)
    out = np.zeros(len(xy), bool)
    out[inside] = grid[tuple(cell[inside].T)]
    return out
