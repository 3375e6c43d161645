"""All that the views say about the surface, gathered in one pass."""

from dataclasses import dataclass

import numpy as np

from realsim.core.errors import MeshError
from realsim.core.meshes import near_pieces
from realsim.core.ordered import in_order
from realsim.core.progress import track
from realsim.core.types import F64, AlignedScene
from realsim.meshing.fuse import Grid, Points, drop_tails, project, thin
from realsim.meshing.views import camera_of, inverse_depth, noise_of, sample_view
from realsim.meshing.visibility import DepthMap, depth_map, seen_through, votes

MOVED = 0.045
"""Square metres in one piece that LOOKS views or more look through, though others measured it: something moved there,
or poses are off. Without anything that moves it is 0 to 0.003 in six rendered captures and 0 to 0.03 in four real ones
(Kinect, RealSense, iPhone); somebody who stands there and leaves, or shifts from foot to foot, makes 0.06 to 0.11, and
who walks 0.2 to 0.9. On seven rendered captures that it was not set on: two without anything 0 and 0.003, five with
somebody 0.08 to 0.24."""
LOOKS = 4


@dataclass(frozen=True)
class Evidence:
    """Fused points with what is needed to tell empty from unseen."""

    points: Points
    maps: tuple[DepthMap, ...]
    """One a view; empty for scans."""
    sigma: float
    """Noise of inverse depth of one pixel, 1/m."""
    noise: float
    """Robust deviation of fused cells from the local surface before the last denoising, metres."""
    resolution: float
    """Metres a cell that this noise and density can carry."""
    statistics: dict[str, float]
    warnings: tuple[str, ...] = ()


def gather(aligned: AlignedScene, resolution: float | None, min_views: int) -> Evidence:
    """Points of all views of an aligned capture; each view is loaded once (a few twice, to measure the noise).

    Raises:
        MeshError: no view has points inside the bounds.
    """
    metric = aligned.metric
    assert metric is not None
    n = len(metric)
    probe = range(0, n, max(1, n // 8))
    samples = [inverse_depth(metric.load(i)) for i in probe]
    sigma = float(np.median([noise_of(d) for d in samples]))
    if sigma <= 0:
        raise MeshError("the views hold too few points for a surface", found=f"{n} views")
    cell = resolution or choose_resolution(sigma, aligned)
    grid = Grid(aligned.bounds, cell)

    def one(i: int) -> tuple[tuple[np.ndarray, np.ndarray], DepthMap, int, bool]:
        view = metric.load(i)
        T_sim_camera = aligned.T_sim_camera(i)
        camera = camera_of(metric.frames[i], view)
        seen, depth = sample_view(view, camera, T_sim_camera, aligned.bounds, sigma, phase=i)
        return (
            grid.rows_of(seen),
            depth_map(depth, camera, T_sim_camera),
            len(seen.points),
            view.color is not None,
        )

    maps, total, has_color = [], 0, True
    for rows, view_map, count, colored in track(in_order(one, n), "surface points", n):
        grid.add(*rows)
        maps.append(view_map)
        total += count
        has_color &= colored
    points = grid.points(has_color=has_color)
    if len(points) < 100:
        raise MeshError(
            "no surface points inside the bounds",
            expected=f"points between {aligned.bounds[0].round(2)} and {aligned.bounds[1].round(2)}",
            found=f"{len(points)} of {n} views",
        )
    cells = len(points)
    points = drop_tails(points, 3 * cell)
    points = points.where(points.views >= min_views)
    points, noise = project(points, 1.5 * cell, iterations=1, neighbours=16)
    through, measured = votes(points.points, maps, sigma, cell)
    flying = seen_through(through, measured)
    warnings = _moved(points.points[flying & (through >= LOOKS)], cell, float(flying.mean()))
    points, _ = project(thin(points.where(~flying), 0.75 * cell), 1.5 * cell, iterations=2, neighbours=24)
    statistics = {
        "samples": total,
        "cells": cells,
        "flying": int(flying.sum()),
        "points": len(points),
        "pixel_noise_1m_mm": 1e3 * sigma,
        "point_noise_mm": 1e3 * noise,
    }
    return Evidence(points, tuple(maps), sigma, noise, cell, statistics, warnings)


def _moved(points: F64, cell: float, share: float) -> tuple[str, ...]:
    """The warning about places (M, 3), one a cell of `cell` metres, that were measured by some views and looked through
    by LOOKS others; `share` of all places were looked through."""
    if len(points) * cell**2 < MOVED:
        return ()
    piece = near_pieces(points, 2.5 * cell)
    area = np.bincount(piece) * cell**2
    if area.max() < MOVED:
        return ()
    (x0, y0, _), (x1, y1, _) = np.percentile(points[area[piece] >= MOVED], (5, 95), axis=0)
    return (
        f"other frames looked through places that some measured ({share:.0%} of them all, {area.max():.2f} m2 in one "
        f"piece), mostly at x {x0:.1f} to {x1:.1f}, y {y0:.1f} to {y1:.1f} m: a person or a thing moved there, or "
        "poses are off. It was left out, but parts that few frames saw may remain",
    )


def choose_resolution(sigma: float, aligned: AlignedScene) -> float:
    """Metres a cell: two sigmas of one pixel at the median distance of the scene's middle, within 8 and 40 mm.

    Finer than the noise, a cell holds points of one side of the true surface only, and the mesh follows the noise.
    No scene gets more than 512 cells along its longest side.
    """
    metric = aligned.metric
    assert metric is not None
    middle = aligned.bounds.mean(0)
    cameras = np.array([aligned.T_sim_camera(i)[:3, 3] for i in range(len(metric))])
    distance = float(np.median(np.sort(np.linalg.norm(cameras - middle, axis=1))[: max(1, len(cameras) // 2)]))
    extent = float((aligned.bounds[1] - aligned.bounds[0]).max())
    return float(np.clip(np.round(2 * sigma * distance**2, 4), max(0.008, extent / 512), 0.04))
