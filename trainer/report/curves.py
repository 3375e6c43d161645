"""A plot over iterations, samples and training minutes: three pictures, of which the page shows one.

Several runs are one colour each. The figures of long runs are means over as many iterations in each of them, so that
the noise of two curves can be compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from realsim.core.types import F64
from realsim.report import page, svg
from trainer.report.history import AXES, Run

POINTS = 200
"""At most this many points a curve: a phone shows about a point a pixel pair."""
DOTTED = 30
"""Curves of at most as many points show them."""
WIDTH, HEIGHT = 360, 190
"""SVG units; about the width of a third of the page, and of a phone."""

Scale = Literal["plain", "share", "log"]


@dataclass(frozen=True)
class Curve:
    """(M,) y over (M,) x on every axis that is known for it."""

    name: str
    x: dict[str, F64]
    y: F64
    color: int = 0
    dots: bool = False
    """Whether the points are shown however many there are."""


def bin_width(runs: Sequence[Run]) -> int:
    """Iterations that make a point."""
    return -(-max(map(len, runs)) // POINTS)


def curve(run: Run, figure: str, name: str, color: int, width: int) -> Curve | None:
    """A figure of a run, `width` iterations a point; None if the run does not have it."""
    values = run.column(figure)
    if values is None:
        return None
    y = binned(values, run.weights(figure), width)
    known = np.isfinite(y)
    # A point lies in the middle of its iterations.
    x = {axis: binned(over, np.ones(len(run)), width)[known] for axis, over in run.over.items()}
    return Curve(name, x, y[known], color)


def evaluated(run: Run, name: str, color: int) -> Curve | None:
    """Success in the evaluations on the way."""
    if not len(run.on_the_way):
        return None
    return Curve(name, {axis: run.evaluated_over(axis) for axis in run.over}, run.on_the_way[:, 1], color, dots=True)


def binned(values: F64, weights: F64, width: int) -> F64:
    """Weighted means of `width` values each (the last of what is left); NaN where nothing finite counts."""
    starts = np.arange(0, len(values), width)
    counted = np.where(np.isfinite(values), weights, 0.0)
    sums = np.add.reduceat(np.nan_to_num(values) * counted, starts)
    totals = np.add.reduceat(counted, starts)
    return np.where(totals > 0, sums / np.where(totals > 0, totals, 1.0), np.nan)


def ends(runs: Sequence[Run]) -> dict[str, float]:
    """Axis -> how far the longest run went on it; axes that no run knows are left out."""
    return {
        axis: max(r.over[axis][-1] for r in runs if axis in r.over)
        for axis in AXES
        if any(axis in r.over for r in runs)
    }


def plot(
    title: str,
    curves: Sequence[Curve],
    reach: dict[str, float],
    *,
    scale: Scale = "plain",
    legend: bool = False,
) -> str:
    """A picture an axis, under a title.

    Args:
        title: what is drawn.
        curves: in the order of the legend.
        reach: axis -> its end (`ends`): the same for all plots of a page.
        scale: `share` writes percent, from 0; `log` is logarithmic to the base 10.
        legend: whether the curves are named below.
    """
    pictures = []
    for axis in reach:
        drawn = [(c.x[axis], c.y, c) for c in curves if axis in c.x]
        if not drawn:
            picture = f'<p class="note">Not known over {axis}.</p>'
        else:
            picture = _axes(title, axis, drawn, reach[axis], scale, legend)
        pictures.append(f'<div class="over {axis}">{picture}</div>')
    return f"<figure><h4>{page.esc(title)}</h4>{''.join(pictures)}</figure>"


def _axes(
    title: str,
    axis: str,
    drawn: Sequence[tuple[F64, F64, Curve]],
    reach: float,
    scale: Scale,
    legend: bool,
) -> str:
    unit, label = unit_of(axis, reach)
    y_range, y_ticks = _range(np.concatenate([y for _, y, _ in drawn]), scale)
    axes = svg.Axes((0.0, 1.02 * reach / unit), y_range, width=WIDTH, height=HEIGHT, x_label=label, y_ticks=y_ticks)
    for x, y, c in drawn:
        points = np.column_stack([x / unit, _log(y) if scale == "log" else y])
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 1:
            axes.polyline(points, svg.color(c.color), dash="" if c.color < 8 else "5 3", title=c.name)
        if c.dots or len(points) <= DOTTED:
            axes.dots(points, svg.color(c.color), radius=2.2, titles=[f"{c.name}: {format_value(v, scale)}" for v in y])
        if legend:
            axes.legend(c.name, svg.color(c.color))
    return axes.svg(f"{title} over {axis}")


def unit_of(axis: str, reach: float) -> tuple[float, str]:
    """What an axis counts in, and its label."""
    if axis != "samples":
        return 1.0, "training minutes" if axis == "minutes" else axis
    return (1e6, "million samples") if reach >= 1e6 else (1e3, "thousand samples")


def format_value(value: float, scale: Scale = "plain") -> str:
    """A figure as text."""
    if not math.isfinite(value):
        return "–"
    return f"{100 * value:.1f} %" if scale == "share" else svg.number(value)


def _log(y: F64) -> F64:
    return np.log10(np.where(y > 0, y, np.nan))


def _range(y: F64, scale: Scale) -> tuple[svg.Range, list[tuple[float, str]] | None]:
    """Range of an axis with its ticks, if they are not to be round numbers of the range."""
    if scale == "share":
        top = 1.0 if y.max(initial=0.0) > 0.5 else max(1.15 * float(y.max(initial=0.0)), 0.02)
        steps = svg.ticks(0.0, top, 4)
        return (-0.03 * top, 1.03 * top), [(v, f"{svg.number(100 * v)} %") for v in steps]
    if scale == "plain":
        return svg.padded(y), None
    low, high = svg.padded(_log(y), 0.08)
    for digits in ((1,), (1, 3), (1, 2, 5)):
        tens = [(math.log10(m) + k, svg.number(m * 10.0**k, 1)) for k in range(-30, 31) for m in digits]
        inside = [t for t in tens if low <= t[0] <= high]
        if len(inside) > 1:
            return (low, high), inside[:: -(-len(inside) // 6)]
    values = [v for v in svg.ticks(10.0**low, 10.0**high, 3) if v > 0]
    return (low, high), [(math.log10(v), text) for v, text in svg.labelled(values)]
