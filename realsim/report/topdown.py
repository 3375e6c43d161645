"""The scene from above: height of the mesh, platforms, axes, start and goal, and the way the camera went."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.core.rays import heights
from realsim.core.types import F64, U8, AlignedScene, TerrainMesh
from realsim.report import raster, svg
from realsim.report.marks import Mark
from realsim.report.page import esc, legend

Extent = tuple[float, float, float, float]
"""x low, x high, y low, y high in metres."""
INVENTED = (172, 112, 214)
"""Colour of what no camera saw."""
ROLE_INK = {"start": "var(--c1)", "goal": "var(--c5)"}
"""Colours of the platforms' outlines."""
_CELLS = 900
"""Cells along the longer side of the height map at most."""


def map_from_above(
    aligned: AlignedScene, mesh: TerrainMesh, marks: Sequence[Mark] = (), *, unseen: bool = False
) -> str:
    """The map as SVG, once for a wide page and once for a phone (style.css shows one), with its legend.

    Args:
        marks: places to mark; unseen: whether what no camera saw is painted.
    """
    seen = mesh.vertices[np.unique(mesh.seen)]
    eyes = camera_positions(aligned)
    inside = np.vstack([seen[:, :2], eyes[:, :2], *(m.at[None, :2] for m in marks)])
    (x0, y0), (x1, y1) = inside.min(0) - 0.08, inside.max(0) + 0.08
    extent = (float(x0), float(x1), float(y0), float(y1))
    step = max(x1 - x0, y1 - y0) / _CELLS
    grid = heights(mesh.vertices, mesh.seen, (x0, y0), (x1, y1), step)[::-1]
    low, high = (float(v) for v in np.nanpercentile(grid, [0.5, 99.8]))
    picture = shaded(raster.colorize(grid, low, high), grid, (x1 - x0) / grid.shape[1])
    if unseen and mesh.invented.any():
        hidden = heights(mesh.vertices, mesh.triangles[mesh.invented], (x0, y0), (x1, y1), step)[::-1]
        picture[np.isnan(grid) & np.isfinite(hidden)] = (*INVENTED, 255)
    # At most as tall as a screen: a terrain that is not long is drawn narrower than the page.
    broad = min(980.0, max(360.0, 620 * (extent[1] - extent[0]) / (extent[3] - extent[2])))
    wide = _map(aligned, eyes, extent, picture, marks, width=broad)
    long = extent[1] - extent[0] > 1.3 * (extent[3] - extent[2])
    narrow = _map(aligned, eyes, extent, picture[::2, ::2], marks, width=360, x_up=long)
    style = f' style="max-width:{broad:.0f}px;margin:0 auto"' if broad < 980 else ""
    bar, keys = svg.color_bar(low, high, "m", label="height"), _legend(aligned, marks, unseen)
    return f'<div class="broad"{style}>{wide}</div><div class="narrow">{narrow}</div>{bar}{keys}'


def _legend(aligned: AlignedScene, marks: Sequence[Mark], unseen: bool) -> str:
    """What the outlines, the path and the marks are."""
    roles = dict.fromkeys(p.role for p in aligned.platforms)
    items = [
        (f"{role} platform" if role in ROLE_INK else "other level top", ROLE_INK.get(role, "#ffffff")) for role in roles
    ]
    if aligned.metric is not None:
        items.append(("camera positions, with viewing directions", "#1b2030"))
    if unseen:
        items.append(("no camera saw this", f"rgb{INVENTED}"))
    if marks:
        items.append(("what decides the verdict", "var(--bad)"))
    return legend([(name, f"{ink};outline:1px solid var(--line)") for name, ink in items])


def _map(
    aligned: AlignedScene, eyes: F64, extent: Extent, picture: U8, marks: Sequence[Mark], *, width: float,
    x_up: bool = False,
) -> str:  # fmt: skip
    """The map `width` units wide; texts keep their size, so that a small one is readable too. x points right, or up."""
    # What is drawn at (x, y) is data @ turn.
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]]) if x_up else np.eye(2)
    low, high = np.sort(np.array([[extent[0], extent[2]], [extent[1], extent[3]]]) @ turn, axis=0)
    across, up = (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))
    numbers = svg.labelled(svg.ticks(extent[2], extent[3], 4))
    axes = svg.Axes(
        across,
        up,
        width=width,
        equal=True,
        x_label="y (m)" if x_up else "x (m)",
        y_label="x (m)" if x_up else "y (m)",
        x_ticks=[(-v, text) for v, text in numbers] if x_up else None,
        grid=False,
    )
    axes.image(
        raster.photo_uri(np.ascontiguousarray(np.rot90(picture) if x_up else picture), _CELLS, 85), (*across, *up)
    )
    thin = max(0.7, width / 980)
    for p in aligned.platforms:
        ink = ROLE_INK.get(p.role, "#ffffff")
        axes.polyline(p.outline @ turn, ink, width=2.4 * thin, closed=True, title=_about(p))
    _camera_path(axes, aligned, eyes, turn, thin)
    for name, ink, text_ink in (("x", "#ff5d5d", "#ff5d5d"), ("y", "#4fd36b", "#2fb14d")):
        tip = 0.35 * turn[0 if name == "x" else 1]
        axes.arrow((0, 0), tip, ink, 3)
        axes.text(1.16 * tip[0], 1.16 * tip[1], name, dy=5, fill=text_ink, halo=True)
    for p in aligned.platforms:
        if p.role in ("start", "goal"):
            x, y = p.centroid[:2] @ turn
            # The axes stand on the start platform, and some marks on a platform's middle.
            below = 0.16 if p.role == "start" or any(np.allclose(m.at, p.centroid) for m in marks) else 0.0
            axes.text(x, y - below, p.role, dy=5, fill="var(--ink)", halo=True)
    mark(axes, marks, turn)
    return axes.svg("height map from above")


def mark(axes: svg.Axes, marks: Sequence[Mark], turn: F64 | None = None) -> None:
    """Draw marks, each text once."""
    for k, m in enumerate(marks):
        x, y = m.at[:2] if turn is None else m.at[:2] @ turn
        axes.dots([(x, y)], "var(--bad)", radius=4.5, titles=[m.text])
        if m.text not in {before.text for before in marks[:k]}:
            axes.text(x, y, m.text, dy=-8, fill="var(--bad)", halo=True)


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


def _camera_path(axes: svg.Axes, aligned: AlignedScene, eyes: F64, turn: F64, thin: float) -> None:
    if not len(eyes):
        return
    assert aligned.metric is not None
    names = [f.name for f in aligned.metric.frames]
    at = eyes[:, :2] @ turn
    ahead = np.stack([aligned.T_sim_camera(i)[:2, 2] for i in range(len(eyes))]) @ turn
    looks = np.full((3 * len(eyes), 2), np.nan)
    looks[0::3], looks[1::3] = at, at + 0.1 * ahead
    # Light on dark, so that the way is readable over the map and beside it, in both themes.
    for ink, extra in (("#1b2030", 1.8), ("#ffffff", 0.0)):
        axes.polyline(at, ink, width=thin * (1.2 + extra)).polyline(looks, ink, width=thin * (0.9 + extra))
        axes.dots(at, ink, radius=thin * (2.0 + extra / 2), titles=names)
    away = 18 if len(at) > 1 and at[1, 1] > at[0, 1] else -10  # where the way does not go
    axes.text(at[0, 0], at[0, 1], "first view", anchor="start", dy=away, fill="var(--ink)", halo=True)


def _about(p: Any) -> str:
    return esc(f"{p.role}: {p.size[0]:.2f} x {p.size[1]:.2f} m, {p.size[2]:.3f} m high, {p.area:.2f} m² seen")
