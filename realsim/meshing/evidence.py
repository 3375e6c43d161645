"""All that the views say about the surface, gathered in one pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from realsim.errors import MeshError
from realsim.meshing.fuse import Grid, Points, drop_tails, project, thin
from realsim.meshing.views import inverse_depth, noise_of, pinhole, sample_view
from realsim.meshing.visibility import DepthMap, depth_map, seen_through, votes
from realsim.ordered import in_order
from realsim.progress import track
from realsim.types import F64, AlignedScene

MOVED = 0.04
"""Share of the cells that other views looked through from which something moved, or poses are off. Without anything
that moves it is 0 to 0.3 % in five rendered captures and 0 to 1.5 % in five real ones (Kinect, RealSense, iPhone); with
somebody who walks by at 0.1 to 0.4 m a frame 22 to 28 %."""


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
        seen, depth = sample_view(view, T_sim_camera, aligned.bounds, sigma, phase=i)
        return (
            grid.rows_of(seen),
            depth_map(depth, *pinhole(view), T_sim_camera),
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
    flying = seen_through(*votes(points.points, maps, sigma, cell))
    warnings = _moved(points.points[flying], float(flying.mean()))
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


def _moved(points: F64, share: float) -> tuple[str, ...]:
    """The warning about places that were measured by some views and seen through by others (M, 3)."""
    if share < MOVED:
        return ()
    (x0, y0, _), (x1, y1, _) = np.percentile(points, (5, 95), axis=0)
    return (
        f"{share:.0%} of what was measured lies where other frames looked through, mostly at x {x0:.1f} to {x1:.1f}, "
        f"y {y0:.1f} to {y1:.1f} m: a person or a thing moved there, or poses are off. It was left out, but parts that "
        "few frames saw may remain",
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
