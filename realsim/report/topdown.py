"""The scene from above: height of the mesh, platforms, axes, start and goal, and the way the camera went."""

from __future__ import annotations

from typing import Any

import numpy as np

from realsim.report import raster, svg
from realsim.report.page import esc
from realsim.types import F64, U8, AlignedScene, TerrainMesh

_CELLS = 900
"""Cells along the longer side of the height map at most."""


def height_map(mesh: TerrainMesh, extent: tuple[float, float, float, float]) -> F64:
    """(H, W) height of the highest seen surface on a grid over the extent, NaN where there is none; row 0 at y high."""
    import open3d

    o3d: Any = open3d
    step = max((extent[1] - extent[0]), (extent[3] - extent[2])) / _CELLS
    x = np.arange(extent[0] + step / 2, extent[1], step)
    y = np.arange(extent[2] + step / 2, extent[3], step)[::-1]
    top = float(mesh.vertices[:, 2].max()) + 1.0
    X, Y = np.meshgrid(x, y)
    rays = np.stack([X, Y, np.full_like(X, top), 0 * X, 0 * X, np.full_like(X, -1.0)], -1).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(np.ascontiguousarray(mesh.seen, np.uint32))
    )
    t = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return np.where(np.isfinite(t), top - t, np.nan)


def map_from_above(aligned: AlignedScene, mesh: TerrainMesh) -> str:
    """The map as SVG with its legend."""
    seen = mesh.vertices[np.unique(mesh.seen)]
    eyes = camera_positions(aligned)
    inside = np.vstack([seen[:, :2], eyes[:, :2]]) if len(eyes) else seen[:, :2]
    (x0, y0), (x1, y1) = inside.min(0) - 0.08, inside.max(0) + 0.08
    extent = (float(x0), float(x1), float(y0), float(y1))
    heights = height_map(mesh, extent)
    low, high = (float(v) for v in np.nanpercentile(heights, [0.5, 99.8]))
    axes = svg.Axes(extent[:2], extent[2:], width=980, equal=True, x_label="x (m)", y_label="y (m)", grid=False)
    picture = shaded(raster.colorize(heights, low, high), heights, (extent[1] - extent[0]) / heights.shape[1])
    axes.image(raster.png_uri(picture), extent)
    for p in aligned.platforms:
        ink = {"start": "var(--c1)", "goal": "var(--c5)"}.get(p.role, "#ffffff")
        axes.polyline(p.outline, ink, width=2.4, closed=True, title=_about(p))
    _camera_path(axes, aligned, eyes)
    axes.arrow((0, 0), (0.35, 0), "#ff5d5d", 3).arrow((0, 0), (0, 0.35), "#4fd36b", 3)
    axes.text(0.35, 0, "x", dx=9, dy=5, fill="#ff5d5d", halo=True).text(0, 0.35, "y", dy=-5, fill="#2fb14d", halo=True)
    for p in aligned.platforms:
        if p.role in ("start", "goal"):
            axes.text(
                p.centroid[0], p.centroid[1], p.role, dy=30 if p.role == "start" else 5, fill="var(--ink)", halo=True
            )
    return f'<div class="scroll">{axes.svg("height map from above", "broad")}</div>' + svg.color_bar(low, high, "m")


def shaded(picture: U8, heights: F64, cell: float) -> U8:
    """The picture (H, W, 4), lit from the upper left as a relief."""
    slope_y, slope_x = np.gradient(heights, cell)
    light = (1.0 + 0.5 * slope_x + 0.5 * slope_y) / np.sqrt(1 + slope_x**2 + slope_y**2)
    light = np.clip(np.nan_to_num(light, nan=1.0), 0.45, 1.2)
    out = picture.copy()
    out[..., :3] = np.clip(picture[..., :3] * light[..., None], 0, 255)
    return out


def camera_positions(aligned: AlignedScene) -> F64:
    """(N, 3) of the cameras in the simulation frame; (0, 3) for a scan."""
    if aligned.metric is None:
        return np.zeros((0, 3))
    return np.stack([aligned.T_sim_camera(i)[:3, 3] for i in range(len(aligned.metric))])


def _camera_path(axes: svg.Axes, aligned: AlignedScene, eyes: F64) -> None:
    if not len(eyes):
        return
    assert aligned.metric is not None
    names = [f.name for f in aligned.metric.frames]
    ahead = np.stack([aligned.T_sim_camera(i)[:2, 2] for i in range(len(eyes))])
    looks = np.full((3 * len(eyes), 2), np.nan)
    looks[0::3], looks[1::3] = eyes[:, :2], eyes[:, :2] + 0.1 * ahead
    # Light on dark, so that the way is readable over the map and beside it, in both themes.
    for ink, extra in (("#1b2030", 1.8), ("#ffffff", 0.0)):
        axes.polyline(eyes[:, :2], ink, width=1.2 + extra).polyline(looks, ink, width=0.9 + extra)
        axes.dots(eyes[:, :2], ink, radius=2.0 + extra / 2, titles=names)
    axes.text(eyes[0, 0], eyes[0, 1], "first view", anchor="start", dy=-10, fill="var(--ink)", halo=True)


def _about(p: Any) -> str:
    return esc(f"{p.role}: {p.size[0]:.2f} x {p.size[1]:.2f} m, {p.size[2]:.3f} m high, {p.area:.2f} m² seen")
