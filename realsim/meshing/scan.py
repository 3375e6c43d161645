"""Finished scans: meshes are cropped and cleaned, clouds are meshed."""

from dataclasses import replace

import numpy as np

from realsim.core.errors import MeshError
from realsim.core.geometry import transform
from realsim.core.meshes import edges_of
from realsim.core.types import F64, AlignedScene
from realsim.meshing.clean import weld
from realsim.meshing.config import MeshConfig
from realsim.meshing.fuse import Points, thin
from realsim.meshing.methods import screened_poisson
from realsim.meshing.quality import degenerate
from realsim.meshing.surface import Surface, colored_from, components
from realsim.meshing.trim import keep_measured

LEVEL = 0.8
"""Least z of the normal of a level face. Between 0.7 and 0.8 as many side faces are turned rightly (0.1 to 3 % wrong on
seven simulated scans, on which it was set; 38 % without). On two real rooms: 20 and 35 % wrong, without 33 and 36."""


def surface_of_scan(aligned: AlignedScene, config: MeshConfig) -> tuple[Surface, float, float | None, str]:
    """Surface in the simulation frame, resolution (m), point noise (m) or None, and how it came about."""
    scan = aligned.scan
    assert scan is not None
    points = transform(aligned.T_sim_world, scan.points)
    if scan.triangles is not None:
        surface = weld(Surface(points, scan.triangles, scan.colors), 1e-5)
        surface = weld(crop(surface, aligned.bounds), 1e-5)  # a cut through a vertex leaves it twice
        surface = oriented(surface.where(~degenerate(surface)))
        return surface, _edge_length(surface), None, "scan mesh"
    inside = ((points > aligned.bounds[0]) & (points < aligned.bounds[1])).all(1)
    if inside.sum() < 100:
        raise MeshError("the cloud has too few points inside the bounds", file=scan.source, found=str(inside.sum()))
    normals = None if scan.normals is None else scan.normals[inside] @ aligned.T_sim_world[:3, :3].T
    colors = None if scan.colors is None else scan.colors[inside]
    sensor = None if scan.sensor_position is None else transform(aligned.T_sim_world, scan.sensor_position)
    return _surface_of_cloud(points[inside], normals, colors, sensor, config)


def crop(surface: Surface, bounds: F64) -> Surface:
    """What lies inside the bounds (2, 3), cut exactly: the floor of a mesh made by hand may be two triangles."""
    for axis in range(3):
        surface = _cut(surface, surface.vertices[:, axis] - bounds[0, axis])
        surface = _cut(surface, bounds[1, axis] - surface.vertices[:, axis])
    return surface


def _cut(surface: Surface, depth: F64) -> Surface:
    """The part with positive `depth` (V,), a linear function of the place. Cut edges stay shared."""
    depth = np.where(np.abs(depth) < 1e-6, 0.0, depth)
    inside = depth[surface.triangles] >= 0
    count = np.where((depth[surface.triangles] > 0).any(1), inside.sum(1), 0)
    whole = surface.where(count == 3)
    crossed = np.flatnonzero((count == 1) | (count == 2))
    if not len(crossed):
        return whole
    # Turned so that the first corner is the one that is alone on its side.
    alone = np.argmax(inside[crossed] == (count[crossed] == 1)[:, None], axis=1)
    corners = np.take_along_axis(surface.triangles[crossed], (alone[:, None] + np.arange(3)) % 3, axis=1)
    edges = np.sort(np.stack([corners[:, [0, 1]], corners[:, [0, 2]]], 1).reshape(-1, 2), axis=1)
    unique, new = np.unique(edges, axis=0, return_inverse=True)
    part = (depth[unique[:, 0]] / (depth[unique[:, 0]] - depth[unique[:, 1]]))[:, None]

    def between(values: F64) -> F64:
        return (1 - part) * values[unique[:, 0]] + part * values[unique[:, 1]]

    vertices = np.concatenate([surface.vertices, between(surface.vertices)])
    colors = None
    if surface.colors is not None:
        extra = np.rint(between(surface.colors.astype(np.float64))).astype(np.uint8)
        colors = np.concatenate([surface.colors, extra])
    (first, second), (a, b, c) = (new.reshape(-1, 2) + len(surface.vertices)).T, corners.T
    tip = count[crossed] == 1
    parts = [
        surface.triangles[count == 3],
        np.column_stack([a, first, second])[tip],
        np.column_stack([first, b, c])[~tip],
        np.column_stack([first, c, second])[~tip],
    ]
    triangles = np.concatenate(parts).astype(np.int32)
    return Surface(vertices, triangles, colors).where(np.ones(len(triangles), bool))


def oriented(surface: Surface) -> Surface:
    """Neighbours wound alike, and the whole such that most of its level area faces up (what a scanner sees)."""
    import pymeshlab

    if len(surface.triangles) == 0:
        return surface
    if edges_of(surface.triangles).uses.max() <= 2:
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.triangles))
        meshes.meshing_re_orient_faces_coherently()
        surface = Surface(surface.vertices, meshes.current_mesh().face_matrix().astype(np.int32), surface.colors)
    n, piece = components(surface.triangles)
    # A closed piece has as much area up as down: there the upper half decides.
    centre = surface.centres()[:, 2]
    mean = np.bincount(piece, centre, minlength=n) / np.bincount(piece, minlength=n)
    upper = centre >= mean[piece] - 1e-9
    up = np.bincount(piece, surface.crosses()[:, 2] * upper, minlength=n)
    flip = (up < 0)[piece]
    triangles = np.where(flip[:, None], surface.triangles[:, ::-1], surface.triangles)
    return Surface(surface.vertices, triangles, surface.colors)


def _surface_of_cloud(
    points: F64, normals: F64 | None, colors: np.ndarray | None, sensor: F64 | None, config: MeshConfig
) -> tuple[Surface, float, float | None, str]:
    from scipy.spatial import cKDTree

    from realsim.core.open3d import o3d

    pick = np.linspace(0, len(points) - 1, min(len(points), 5000)).astype(int)
    tree = cKDTree(points)
    spacing = float(np.median(tree.query(points[pick], k=7, workers=2)[0][:, 6]))
    _, near = tree.query(points[pick], k=12, workers=2)
    local = points[near] - points[near].mean(1, keepdims=True)
    least = np.linalg.eigvalsh(np.swapaxes(local, 1, 2) @ local / 12)[:, 0]
    noise = float(np.median(np.sqrt(np.maximum(least, 0.0))))
    resolution = config.resolution or float(np.clip(max(1.5 * spacing, 2 * noise), 0.004, 0.1))
    guessed = normals is None and sensor is None
    if normals is None:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(3 * spacing, 40))
        normals = np.asarray(cloud.normals).copy()
        toward = np.array([0.0, 0.0, 1.0]) if sensor is None else sensor - points
        normals *= np.where((normals * toward).sum(1) < 0, -1.0, 1.0)[:, None]
    fused = thin(Points(points, normals, np.ones(len(points)), np.ones(len(points)), colors), 0.75 * resolution)
    if guessed:
        # Of a side face about half of the points faced in: once turned, a cell's two means are one again.
        fused = thin(replace(fused, normals=outward(fused.points, fused.normals, 3 * resolution)), 0.75 * resolution)
    surface = screened_poisson(fused, resolution)
    surface = keep_measured(surface, fused, max(resolution, spacing))
    return colored_from(surface, points, colors), resolution, noise, "poisson"


def outward(points: F64, normals: F64, reach: float, neighbours: int = 24) -> F64:
    """(M, 3) the normals of a cloud of which nobody knows from where it was seen, turned out of the surface.

    Level faces face up. A side face has lower ground before it: it is turned to where the level points are that lie
    lower, within `reach` metres of it seen from above. One that has none beside it is left facing up.

    Args:
        points, normals: (M, 3) metres, z up; unit, of either sign.
    """
    from scipy.spatial import cKDTree

    normals = np.where(normals[:, 2:] < 0, -normals, normals)
    level = normals[:, 2] > LEVEL
    side = np.flatnonzero(~level)
    if not level.any() or not len(side):
        return normals
    distance, near = cKDTree(points[level][:, :2]).query(
        points[side, :2], k=min(neighbours, int(level.sum())), distance_upper_bound=reach, workers=2
    )
    distance, near = distance.reshape(len(side), -1), near.reshape(len(side), -1)
    found = np.isfinite(distance)
    away = points[level][np.where(found, near, 0)] - points[side, None]
    before = np.einsum("mki,mi->mk", away[..., :2], normals[side, :2]) / np.maximum(distance, 1e-9)
    lower = found & (away[..., 2] < -reach / 4)
    normals[side[(before * lower).sum(1) < 0]] *= -1
    return normals


def _edge_length(surface: Surface) -> float:
    if len(surface.triangles) == 0:
        return 0.01
    edges = edges_of(surface.triangles)
    ends = surface.vertices[edges.runs[edges.order[edges.first]]]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    return float(np.clip(np.median(length), 0.005, 0.1))
