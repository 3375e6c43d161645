"""Measured, nominal and patched, drawn over each other where the gap is largest; and the way of the base."""

from __future__ import annotations

import numpy as np

from realsim.gap.diagnosis import Diagnosis
from realsim.gap.report_series import Replay, worst_windows
from realsim.gap.report_words import short, signal_name, unit_of
from realsim.gap.simulate import measured
from realsim.report import page, raster, svg
from realsim.types import F64

_ROW = 'style="display:grid;gap:14px 26px;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr))"'
_MEASURED, _NOMINAL, _PATCHED = "var(--ink)", "var(--c1)", "var(--good)"
_POINTS = 220
"""At most this many points a curve: more cannot be seen."""


def overlays_card(found: Diagnosis, shown: Replay) -> str:
    """The worst stretches of the runs of the check, one for each of several signals."""
    if shown.case is None or shown.comparison is None or not shown.before:
        return page.card("Before and after", page.bullets([], shown.reason), wide=True)
    parts = [f"<div>{_overlay(shown, *window)}</div>" for window in worst_windows(shown)]
    keys = [("measured", _MEASURED), ("nominal simulator", _NOMINAL)]
    keys += [("with the diagnosis", _PATCHED)] if shown.after else []
    legend = "".join(f'<span><i style="background:{c}"></i>{t}</span>' for t, c in keys)
    unseen = found.shrinkage.get("unseen", True)
    said = "runs that no fit has seen" if unseen else "the fitted runs"
    note = f"The stretches of {said} where the nominal simulator is farthest from the robot."
    if shown.reason:
        note = f"{note} {shown.reason}"
    body = f'<div {_ROW}>{"".join(parts)}</div><div class="legend">{legend}</div>'
    return page.card("Before and after", body, note, wide=True)


def _overlay(shown: Replay, k: int, channel: int, start: float, end: float) -> str:
    assert shown.case is not None
    assert shown.comparison is not None
    run, c = shown.case.runs[shown.runs[k]], shown.comparison.channels[channel]
    inside = np.flatnonzero((run.time >= start) & (run.time <= end))
    inside = inside[:: max(1, -(-len(inside) // _POINTS))]
    t = run.time[inside]
    real = measured(run, [c])[inside, 0]
    curves = [(shown.before[k][inside, channel], _NOMINAL, 1.8)]
    if shown.after:
        curves.append((shown.after[k][inside, channel], _PATCHED, 1.8))
    # A simulator that flies away must not flatten the rest: the range is the robot's, and as much again.
    spread = svg.padded(real, 0.5)
    every = np.concatenate([real, *(np.clip(y, *spread) for y, _, _ in curves)])
    unit = unit_of(c.signal, c.label, shown.case.model)
    axes = svg.Axes((float(start), float(end)), svg.padded(every, 0.08), x_label="time, s",
                    y_label=f"{signal_name(c.signal)}, {unit}", height=200)  # fmt: skip
    axes.dots(np.column_stack([t, real]), _MEASURED, radius=1.6)
    for y, stroke, width in curves:
        axes.polyline(np.column_stack([t, y]), stroke, width=width, dash="6 3" if stroke == _NOMINAL else "")
    title = f"{short(c.label, 30)}, {signal_name(c.signal)}, {run.name}"
    return f"<h4>{page.esc(title)}</h4>" + axes.svg(title)


def path_card(found: Diagnosis) -> list[str]:
    """The way of the base from above, coloured by the error there; only for robots that move about."""
    comparison, residuals = found.evidence.get("comparison"), found.evidence.get("residuals")
    if comparison is None or residuals is None or not comparison.case.floating or not comparison.case.has("base_pos"):
        return []
    where, error = [], []
    for i, (run, r) in enumerate(zip(comparison.case.runs, residuals, strict=True)):
        base = run.signals["base_pos"]
        where.append(np.column_stack([_at(comparison.times[i], run.time, base[:, a]) for a in (0, 1)]))
        error.append(np.sqrt(np.nanmean(np.nan_to_num(r) ** 2 / comparison.floor(i), axis=1)))
    P, e = np.concatenate(where), np.log10(np.maximum(np.concatenate(error), 1.0))
    step = max(1, len(P) // 700)
    P, e = P[::step], e[::step]
    middle, half = (P.min(0) + P.max(0)) / 2, np.maximum((P.max(0) - P.min(0)).max() / 2, 0.02) * 1.08
    top = max(float(e.max()), 0.3)
    rgb = raster.colorize(e[:, None], 0.0, top, HEAT)[:, 0, :3]
    axes = svg.Axes((middle[0] - half, middle[0] + half), (middle[1] - half, middle[1] + half), equal=True,
                    width=400, x_label="x, m", y_label="y, m")  # fmt: skip
    for i in np.argsort(e, kind="stable"):
        axes.dots(P[i : i + 1], f"rgb({rgb[i][0]},{rgb[i][1]},{rgb[i][2]})", radius=2.4)
    scale = svg.color_bar(1.0, 10.0**top, "× floor", HEAT)
    note = "Where the base was in all runs, coloured by the error of the nominal simulator there (logarithmic)."
    return [page.card("Where on the ground", axes.svg("the base from above, coloured by the error") + scale, note)]


HEAT = ((158, 168, 182), (196, 184, 140), (236, 160, 72), (222, 92, 48), (166, 24, 44))
"""Grey for no gap to dark red for the largest."""


def _at(t: F64, time: F64, values: F64) -> F64:
    good = np.isfinite(values)
    return np.interp(t, time[good], values[good])
