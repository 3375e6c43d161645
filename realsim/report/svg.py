"""Plots as inline SVG: a pair of axes that maps data to pixels and collects marks, and a few figures built from it.

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

from realsim.report.page import legend
from realsim.report.raster import HEIGHT

Range = tuple[float, float]


def color(index: int) -> str:
    """The page's categorical colour `index` (repeats after eight)."""
    return f"var(--c{index % 8})"


def number(value: float, digits: int = 3) -> str:
    """Short text of a number: `digits` significant digits, no exponent for ordinary sizes."""
    if not math.isfinite(value):
        return "–"
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    text = f"{value:.{max(0, digits - 1 - (math.floor(math.log10(abs(value))) if value else 0))}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text.replace("-", "−")


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers (1, 2 or 5 times a power of ten apart) from `low` to `high`."""
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw)) if raw > 0 else 1.0
    step = min((m * power for m in (1, 2, 5, 10)), key=lambda s: abs(s - raw))
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def labelled(values: Sequence[float]) -> list[tuple[float, str]]:
    """Ticks with their text: as many digits as tell neighbours apart."""
    for digits in range(3, 13):
        texts = [number(v, digits) for v in values]
        if len(set(texts)) == len(texts):
            break
    return list(zip(values, texts, strict=True)) if values else []


def padded(values: ArrayLike, share: float = 0.06) -> Range:
    """Range of the finite values with a little air on both sides; (0, 1) if there are none."""
    v = np.asarray(values, float).ravel()
    v = v[np.isfinite(v)]
    if not len(v):
        return 0.0, 1.0
    low, high = float(v.min()), float(v.max())
    air = share * (high - low) or (0.05 * abs(high) or 1.0)
    return low - air, high + air


class Axes:
    """A rectangle of data coordinates. Marks are drawn in the order of the calls; `svg()` gives the picture.

    Args:
        x, y: data ranges (low, high).
        width, height: size of the picture in SVG units; it is scaled to the width of its card.
        equal: same scale on both axes; `height` then follows from `width`.
        x_ticks, y_ticks: [(value, text)] to write instead of round numbers.
        left: room for the numbers and the label of y; by default as much as they take.
    """

    def __init__(
        self,
        x: Range,
        y: Range,
        *,
        width: float = 400,
        height: float = 230,
        equal: bool = False,
        x_label: str = "",
        y_label: str = "",
        x_ticks: Sequence[tuple[float, str]] | None = None,
        y_ticks: Sequence[tuple[float, str]] | None = None,
        left: float | None = None,
        right: float = 10,
        top: float = 10,
        bottom: float = 36,
        grid: bool = True,
    ) -> None:
        self.x, self.y = x, y
        self._x_ticks = x_ticks if x_ticks is not None else labelled(ticks(*x))
        self._y_ticks = y_ticks if y_ticks is not None else labelled(ticks(*y, count=4))
        if left is None:
            left = max(46, 26 + 6.4 * max((len(text) for _, text in self._y_ticks), default=0))
        if equal:
            height = (width - left - right) * (y[1] - y[0]) / (x[1] - x[0]) + top + bottom
        self.width, self.height = width, height
        self.box = (left, top, width - right, height - bottom)
        self.labels = (x_label, y_label)
        self._grid = grid
        self._marks: list[str] = []
        self._outside: list[str] = []
        self._legend: list[tuple[str, str]] = []

    def px(self, x: float) -> float:
        """Picture x of data x."""
        return self.box[0] + (x - self.x[0]) / (self.x[1] - self.x[0]) * (self.box[2] - self.box[0])

    def py(self, y: float) -> float:
        """Picture y of data y (data y points up)."""
        return self.box[3] - (y - self.y[0]) / (self.y[1] - self.y[0]) * (self.box[3] - self.box[1])

    def _path(self, points: ArrayLike) -> str:
        """Path text of (M, 2) data points; it is broken where one is not finite."""
        parts, pen_down = [], False
        for x, y in np.asarray(points, float).reshape(-1, 2):
            if not (math.isfinite(x) and math.isfinite(y)):
                pen_down = False
                continue
            parts.append(f"{'L' if pen_down else 'M'}{self.px(x):.1f} {self.py(y):.1f}")
            pen_down = True
        return "".join(parts)

    def polyline(
        self,
        points: ArrayLike,
        stroke: str = color(0),
        *,
        width: float = 1.6,
        dash: str = "",
        fill: str = "none",
        closed: bool = False,
        opacity: float = 1.0,
        title: str = "",
    ) -> Axes:
        """(M, 2) data points joined by a line."""
        extra = f' stroke-dasharray="{dash}"' if dash else ""
        self._marks.append(
            f'<path d="{self._path(points)}{"Z" if closed else ""}" fill="{fill}" stroke="{stroke}"'
            f' stroke-width="{width}" opacity="{opacity}"{extra} stroke-linejoin="round">{_title(title)}</path>'
        )
        return self

    def dots(self, points: ArrayLike, fill: str = color(0), *, radius: float = 2.6, titles: Sequence[str] = ()) -> Axes:
        """(M, 2) data points; `titles` are shown when the pointer rests on one."""
        for i, (x, y) in enumerate(np.asarray(points, float).reshape(-1, 2)):
            if math.isfinite(x) and math.isfinite(y):
                self._marks.append(
                    f'<circle cx="{self.px(x):.1f}" cy="{self.py(y):.1f}" r="{radius}" fill="{fill}">'
                    f"{_title(titles[i] if titles else '')}</circle>"
                )
        return self

    def span(self, low: float, high: float, fill: str = color(0), *, vertical: bool = False) -> Axes:
        """A stripe over the whole plot between two y values (x values if `vertical`), cut to the plot."""
        a, b = np.clip([low, high], *(self.x if vertical else self.y))
        (x0, x1), (y0, y1) = ((a, b), self.y) if vertical else (self.x, (a, b))
        ring = [(x0, y1), (x1, y1), (x1, y0), (x0, y0)]
        self._marks.append(f'<path d="{self._path(ring)}Z" fill="{fill}" opacity="0.14"/>')
        return self

    def rule(self, value: float, stroke: str = "var(--faint)", *, text: str = "") -> Axes:
        """A dashed line over the whole plot at a y value."""
        self.polyline([(self.x[0], value), (self.x[1], value)], stroke, width=1.2, dash="4 3")
        return self.text(self.x[1], value, text, anchor="end", dy=-4) if text else self

    def whisker(self, y: float, low: float, high: float, stroke: str = color(0)) -> Axes:
        """A horizontal interval with caps at data y."""
        cap, v, a, b = 3.5, self.py(y), self.px(low), self.px(high)
        d = f"M{a:.1f} {v:.1f}H{b:.1f}M{a:.1f} {v - cap:.1f}v{2 * cap}M{b:.1f} {v - cap:.1f}v{2 * cap}"
        self._marks.append(f'<path d="{d}" stroke="{stroke}" stroke-width="1.4" fill="none"/>')
        return self

    def bar(self, y: float, value: float, fill: str = color(0), *, thickness: float = 0.62, title: str = "") -> Axes:
        """A horizontal bar from 0 to `value`, centred at data y."""
        a, b = sorted((self.px(0.0), self.px(value)))
        t, u = self.py(y + thickness / 2), self.py(y - thickness / 2)
        self._marks.append(
            f'<rect x="{a:.1f}" y="{t:.1f}" width="{b - a:.1f}" height="{u - t:.1f}" rx="2" fill="{fill}">'
            f"{_title(title)}</rect>"
        )
        return self

    def text(
        self, x: float, y: float, text: str, *, fill: str = "var(--soft)", anchor: str = "middle",
        dx: float = 0, dy: float = 0, halo: bool = False, outside: bool = False,
    ) -> Axes:  # fmt: skip
        """Text at a data point, shifted by (dx, dy) picture units; `halo`: readable over a picture and inside it."""
        at, down = self.px(x) + dx, self.py(y) + dy
        if halo:
            wide = 6.6 * len(text)  # of bold letters, 11 units high
            before = {"start": 0.0, "middle": wide / 2, "end": wide}[anchor]
            at = max(min(at, self.box[2] - wide + before), self.box[0] + before)
            down = max(min(down, self.box[3] - 3), self.box[1] + 10)
        css = ' class="halo"' if halo else ""
        (self._outside if outside else self._marks).append(
            f'<text x="{at:.1f}" y="{down:.1f}" text-anchor="{anchor}" style="fill:{fill}"{css}>{escape(text)}</text>'
        )
        return self

    def arrow(self, start: Sequence[float], end: Sequence[float], stroke: str, width: float = 2.2) -> Axes:
        """An arrow between two data points."""
        a = np.array([self.px(start[0]), self.py(start[1])])
        b = np.array([self.px(end[0]), self.py(end[1])])
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        side = np.array([-along[1], along[0]])
        tip = [b, b - 8 * along + 4 * side, b - 8 * along - 4 * side]
        head = " ".join(f"{p[0]:.1f},{p[1]:.1f}" for p in tip)
        shaft = b - 6 * along
        self._marks.append(
            f'<path d="M{a[0]:.1f} {a[1]:.1f}L{shaft[0]:.1f} {shaft[1]:.1f}" stroke="{stroke}" stroke-width="{width}"/>'
            f'<polygon points="{head}" fill="{stroke}"/>'
        )
        return self

    def image(self, uri: str, extent: tuple[float, float, float, float]) -> Axes:
        """A picture over (x low, x high, y low, y high); its first row lies at y high."""
        x0, x1, y0, y1 = self.px(extent[0]), self.px(extent[1]), self.py(extent[3]), self.py(extent[2])
        self._marks.append(
            f'<image href="{uri}" x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}"'
            ' preserveAspectRatio="none" image-rendering="optimizeSpeed"/>'
        )
        return self

    def legend(self, name: str, fill: str) -> Axes:
        """An entry of the legend below the plot."""
        self._legend.append((name, fill))
        return self

    def svg(self, label: str = "", css: str = "") -> str:
        """The picture; `label` is what a screen reader says."""
        x0, y0, x1, y1 = self.box
        parts = [
            f'<svg class="plot {css}" viewBox="0 0 {self.width:.0f} {self.height:.0f}" role="img"'
            f' aria-label="{escape(label or " over ".join(filter(None, reversed(self.labels))), quote=True)}">'
        ]
        for value, text in self._x_ticks:
            if self._grid:
                parts.append(f'<path class="grid" d="M{self.px(value):.1f} {y0:.1f}V{y1:.1f}"/>')
            parts.append(f'<text x="{self.px(value):.1f}" y="{y1 + 14:.1f}" text-anchor="middle">{escape(text)}</text>')
        for value, text in self._y_ticks:
            if self._grid:
                parts.append(f'<path class="grid" d="M{x0:.1f} {self.py(value):.1f}H{x1:.1f}"/>')
            parts.append(f'<text x="{x0 - 6:.1f}" y="{self.py(value) + 4:.1f}" text-anchor="end">{escape(text)}</text>')
        frame = f"{x0:.1f} {y0:.1f} {x1 - x0:.1f} {y1 - y0:.1f}".split()
        place = " ".join(f'{k}="{v}"' for k, v in zip(("x", "y", "width", "height"), frame, strict=True))
        # A nested picture cuts off what lies outside the plot, in every browser and without ids.
        parts.append(f'<svg {place} viewBox="{" ".join(frame)}">' + "".join(self._marks) + "</svg>")
        parts += self._outside
        if self.labels[0]:
            parts.append(
                f'<text x="{(x0 + x1) / 2:.1f}" y="{y1 + 31:.1f}" text-anchor="middle" class="axis">'
                f"{escape(self.labels[0])}</text>"
            )
        if self.labels[1]:
            parts.append(
                f'<text transform="translate(11 {(y0 + y1) / 2:.1f}) rotate(-90)" text-anchor="middle" class="axis">'
                f"{escape(self.labels[1])}</text>"
            )
        return "".join([*parts, "</svg>", legend(self._legend)])


def _title(text: str) -> str:
    return f"<title>{escape(text)}</title>" if text else ""


@dataclass(frozen=True)
class Series:
    """One curve: (M,) x and y, NaN where broken."""

    name: str
    x: Any
    y: Any


def line(series: Sequence[Series], *, x_label: str, y_label: str, height: float = 230) -> str:
    """Curves over a common x, overlaid in the palette's order, with a legend if there are several."""
    x, y = (np.concatenate([np.asarray(getattr(s, axis), float).ravel() for s in series]) for axis in ("x", "y"))
    axes = Axes(padded(x, 0.02), padded(y), x_label=x_label, y_label=y_label, height=height)
    for i, s in enumerate(series):
        axes.polyline(np.column_stack([np.asarray(s.x, float), np.asarray(s.y, float)]), color(i))
        if len(series) > 1:
            axes.legend(s.name, color(i))
    return axes.svg()


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
            axes.whisker(y, b.low, b.high, "var(--ink)")
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


def color_bar(
    low: float, high: float, unit: str, colors: tuple[tuple[int, int, int], ...] = HEIGHT, label: str = ""
) -> str:
    """A legend strip for a heat map; `label` says what the colour stands for."""
    stops = ",".join(f"rgb{c}" for c in colors)
    return (
        f'<div class="colorbar"><span>{escape(f"{label}: " if label else "")}{number(low)} {escape(unit)}</span>'
        f'<i style="background:linear-gradient(90deg,{stops})"></i><span>{number(high)} {escape(unit)}</span></div>'
    )
