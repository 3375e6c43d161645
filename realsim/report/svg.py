"""Plots as inline SVG: a few figures built from `Axes`.

Colours are the page's CSS variables (`--c0` to `--c7`), so that a plot follows the light or the dark theme. Numbers are
written with fixed precision: the same data give the same text.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from realsim.report.axes import Axes, Range, color, labelled, number, padded, ticks
from realsim.report.raster import HEIGHT, colorize, png_uri

__all__ = [
    "Axes", "Bar", "Range", "Series", "bars", "color", "color_bar", "heat", "labelled", "line", "number", "padded",
    "scatter", "stacked", "ticks",
]  # fmt: skip


@dataclass(frozen=True)
class Series:
    """One curve: (M,) x and y, NaN where broken."""

    name: str
    x: Any
    y: Any
    kind: str = "line"
    """`line`, `dots` or `both`."""
    dash: str = ""
    low: Any = None
    """(M,) lower and `high` upper bound of a shaded band, or None."""
    high: Any = None


def line(
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    x: Range | None = None,
    y: Range | None = None,
    height: float = 230,
    rules: Sequence[tuple[float, str]] = (),
) -> str:
    """Curves over a common x, overlaid in the palette's order, with a legend if there are several.

    `rules` are horizontal dashed lines (value, text). Ranges are taken from the data if they are not given.
    """
    flat = [np.asarray(v, float).ravel() for s in series for v in (s.y, s.low, s.high) if v is not None]
    xs = np.concatenate([np.asarray(s.x, float).ravel() for s in series])
    axes = Axes(
        x or padded(xs, 0.02), y or padded(np.concatenate(flat)), x_label=x_label, y_label=y_label, height=height
    )
    for value, text in rules:
        axes.rule(value, text=text)
    for i, s in enumerate(series):
        points = np.column_stack([np.asarray(s.x, float), np.asarray(s.y, float)])
        if s.low is not None and s.high is not None:
            axes.band(s.x, s.low, s.high, color(i))
        if s.kind in ("line", "both"):
            axes.polyline(points, color(i), dash=s.dash)
        if s.kind in ("dots", "both"):
            axes.dots(points, color(i))
        if len(series) > 1:
            axes.legend(s.name, color(i))
    return axes.svg()


def scatter(
    points: ArrayLike, *, x_label: str, y_label: str, titles: Sequence[str] = (), diagonal: bool = False
) -> str:
    """(M, 2) points; `diagonal` adds the line x = y and gives both axes the same range."""
    P = np.asarray(points, float).reshape(-1, 2)
    x, y = (padded(P), padded(P)) if diagonal else (padded(P[:, 0]), padded(P[:, 1]))
    axes = Axes(x, y, x_label=x_label, y_label=y_label, height=300 if diagonal else 230)
    if diagonal:
        axes.polyline([(x[0], x[0]), (x[1], x[1])], "var(--faint)", dash="4 3")
    return axes.dots(P, color(0), titles=titles).svg()


@dataclass(frozen=True)
class Bar:
    """A horizontal bar with its name, and an interval if it has one."""

    name: str
    value: float
    low: float | None = None
    high: float | None = None
    fill: str = color(0)
    text: str = ""
    """What stands beside it; the value if empty."""


def bars(items: Sequence[Bar], *, x_label: str, x: Range | None = None, row: float = 26) -> str:
    """Horizontal bars, the first on top, with the name on the left and the value beside the bar."""
    ends = [v for b in items for v in (b.value, b.low, b.high) if v is not None and math.isfinite(v)]
    if x is None:
        low, high = min([0.0, *ends]), max([0.0, *ends])
        x = (low * 1.12, high * 1.22 if high > 0 else 0.1 * abs(low) or 1.0)
    n = len(items)
    left = min(150, 14 + 6.4 * max(len(b.name) for b in items))
    names = [(n - 1 - i, b.name) for i, b in enumerate(items)]
    axes = Axes(x, (-0.5, n - 0.5), height=row * n + 46, x_label=x_label, left=left, y_ticks=names)
    for i, b in enumerate(items):
        y = n - 1 - i
        axes.bar(y, b.value, b.fill, title=f"{b.name}: {number(b.value)}")
        if b.low is not None and b.high is not None:
            axes.whisker(y, b.low, b.high, "var(--ink)", horizontal=True)
        end = max(v for v in (b.value, b.high, 0.0) if v is not None)
        axes.text(end, y, b.text or number(b.value), anchor="start", dx=5, dy=4)
    return axes.svg()


def stacked(parts: Sequence[tuple[str, float]], *, unit: str) -> str:
    """One bar cut into named shares (time by stage), with a legend that gives each figure."""
    total = sum(v for _, v in parts) or 1.0
    axes = Axes((0, total), (0, 1), height=58, left=2, right=2, top=2, bottom=22, y_ticks=[], grid=False,
                x_ticks=[(t, f"{number(t)} {unit}") for t in ticks(0, total * 0.96, 5)])  # fmt: skip
    at = 0.0
    for i, (name, value) in enumerate(parts):
        ring = [(at, 0), (at + value, 0), (at + value, 1), (at, 1)]
        axes.polyline(ring, "var(--card)", width=1, fill=color(i), closed=True, title=f"{name}: {number(value)} {unit}")
        axes.legend(f"{name} {number(value)} {unit}", color(i))
        at += value
    return axes.svg("time by stage")


def heat(
    image: ArrayLike,
    extent: tuple[float, float, float, float],
    *,
    low: float,
    high: float,
    x_label: str = "",
    y_label: str = "",
    colors: tuple[tuple[int, int, int], ...] = HEIGHT,
    width: float = 460,
) -> Axes:
    """Axes over an (H, W) map, row 0 at y high, extent (x low, x high, y low, y high); NaN is left open.

    Returns the axes, so that outlines, paths and labels can be drawn over it before `.svg()`.
    """
    axes = Axes(extent[:2], extent[2:], width=width, equal=True, x_label=x_label, y_label=y_label, grid=False)
    return axes.image(png_uri(colorize(image, low, high, colors)), extent)


def color_bar(
    low: float, high: float, unit: str, colors: tuple[tuple[int, int, int], ...] = HEIGHT, label: str = ""
) -> str:
    """A legend strip for a heat map; `label` says what the colour stands for."""
    stops = ",".join(f"rgb{c}" for c in colors)
    return (
        f'<div class="colorbar"><span>{escape(f"{label}: " if label else "")}{number(low)} {escape(unit)}</span>'
        f'<i style="background:linear-gradient(90deg,{stops})"></i><span>{number(high)} {escape(unit)}</span></div>'
    )
