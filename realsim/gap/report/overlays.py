"""Measured, nominal and patched, drawn over each other where the gap is largest; and the way of the base."""

import numpy as np

from realsim.core.types import F64
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.case.case import Case
from realsim.gap.case.model.channels import unit_of
from realsim.gap.report.series import worst_windows
from realsim.gap.report.words import HEAT, NOT_KEPT, short, signal_name
from realsim.gap.simulation.simulate import measured
from realsim.report import page, raster, svg
from realsim.report.solids import solids

_ROW = 'style="display:grid;gap:14px 26px;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr))"'
_MEASURED, _NOMINAL, _PATCHED = "var(--ink)", "var(--c1)", "var(--good)"
LEFT = 66
"""Room for the numbers (−0.002) and the label of two plots one above the other."""
_POINTS = 220
"""At most this many points a curve: more cannot be seen."""
_NEAR = 1.5
"""Lengths of the way from its middle: solids farther off do not widen the map."""
_BESIDE = 0.6
"""m around the middle that count as near however short the way: what a robot stands on while it sways."""


def overlays_card(found: Diagnosis) -> str:
    """The worst stretches of the runs of the check, one for each of several signals."""
    kept = found.evidence
    if kept is None:
        return page.card("Before and after", page.bullets([], NOT_KEPT), wide=True)
    parts = [f"<div>{_overlay(kept, *window)}</div>" for window in worst_windows(kept)]
    keys = [("measured", _MEASURED), ("nominal simulator", _NOMINAL)]
    keys += [("with the diagnosis", _PATCHED)] if kept.after else []
    runs = "runs that no fit has seen" if found.shrinkage.get("unseen", True) else "the fitted runs"
    note = (
        f"Stretches of {runs} where the nominal simulator is far from the robot; below each, measured minus simulated "
        "(in the stripe: within twice the noise floor)."
    )
    if found.health.get("start", {}).get("parts"):
        note += " Where a curve jumps, the simulator goes on from a state of the log."
    if kept.reason:
        note = f"{note} {kept.reason}"
    body = f"<div {_ROW}>{''.join(parts)}</div>{page.legend(keys)}"
    return page.card("Before and after", body, note, wide=True)


def _overlay(kept: Arrays, k: int, channel: int, start: float, end: float) -> str:
    run, c = kept.case.runs[kept.runs[k]], kept.channels[channel]
    inside = np.flatnonzero((run.time >= start) & (run.time <= end))
    inside = inside[:: max(1, -(-len(inside) // _POINTS))]
    t = run.time[inside]
    real = measured(run, [c])[inside, 0]
    curves = [(kept.before[k][inside, channel], _NOMINAL)]
    if kept.after:
        curves.append((kept.after[k][inside, channel], _PATCHED))
    span, unit = (float(start), float(end)), unit_of(c.signal, c.label, kept.case.model)
    # A simulator that flies away must not flatten the rest: the range is the robot's, and thrice as much again.
    spread = svg.padded(real, 1.5)
    every = np.concatenate([real, *(np.clip(y, *spread) for y, _ in curves)])
    title = f"{short(c.label, 30)}, {signal_name(c.signal)}, {run.name}"
    axes = svg.Axes(span, svg.padded(every, 0.08), y_label=unit, height=170, left=LEFT, bottom=8, x_ticks=[])
    axes.dots(np.column_stack([t, real]), _MEASURED, radius=1.6)
    for y, stroke in curves:
        axes.polyline(np.column_stack([t, y]), stroke, width=1.8, dash="6 3" if stroke == _NOMINAL else "")
    floor = 2 * float(np.hypot(kept.sensor[channel], kept.detail[channel]))
    return (
        f"<h4>{page.esc(title)}</h4>"
        + axes.svg(title)
        + differences(t, [(real - y, s) for y, s in curves], floor, span, "error")
    )


def differences(t: F64, curves: list[tuple[F64, str]], floor: float, span: tuple[float, float], label: str) -> str:
    """What curves differ by on an axis of its own; what lies in the stripe is as good as nothing."""
    largest = max((float(np.nanmax(np.abs(e), initial=0.0)) for e, _ in curves), default=0.0)
    half = 1.1 * max(largest, 1.5 * floor)
    power = 10.0 ** np.floor(np.log10(0.8 * half))
    even = float(0.8 * half // power * power)  # one digit, so that the label is short
    axes = svg.Axes(span, (-half, half), x_label="time, s", y_label=label, height=104, left=LEFT, top=2,
                    y_ticks=[(v, svg.number(v, 1)) for v in (-even, 0.0, even)])  # fmt: skip
    axes.span(-floor, floor, _PATCHED)
    for error, stroke in curves:
        axes.polyline(np.column_stack([t, error]), stroke, width=1.5)
    return axes.svg(f"{label} over time")


def path_card(found: Diagnosis) -> list[str]:
    """The way of the base from above, coloured by the error there; only for robots that move about."""
    kept = found.evidence
    if kept is None or not kept.case.floating or not kept.case.has("base_pos"):
        return []
    where, error = [], []
    for run, r, times, floor in zip(kept.case.runs, kept.residuals, kept.times, kept.floors, strict=True):
        base = run.signals["base_pos"]
        where.append(np.column_stack([_at(times, run.time, base[:, a]) for a in (0, 1)]))
        error.append(np.sqrt(np.nanmean(np.nan_to_num(r) ** 2 / floor, axis=1)))
    P, e = np.concatenate(where), np.log10(np.maximum(np.concatenate(error), 1.0))
    step = max(1, len(P) // 700)
    P, e = P[::step], e[::step]
    ground = _footprints(kept.case)
    near = max(_NEAR * float(np.ptp(P, axis=0).max()), _BESIDE)
    every = np.vstack([P, *(ring for ring in ground if np.abs(ring - P.mean(axis=0)).max() < near)])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    half = max(float(np.ptp(every, axis=0).max()) / 2, 0.02) * 1.08
    top = max(float(e.max()), 0.3)
    rgb = raster.colorize(e[:, None], 0.0, top, HEAT)[:, 0, :3]
    axes = svg.Axes((middle[0] - half, middle[0] + half), (middle[1] - half, middle[1] + half), equal=True,
                    width=400, x_label="x, m", y_label="y, m")  # fmt: skip
    for ring in ground:
        axes.polyline(ring, "var(--faint)", fill="var(--line)", closed=True)
    for i in np.argsort(e, kind="stable"):
        axes.dots(P[i : i + 1], f"rgb({rgb[i][0]},{rgb[i][1]},{rgb[i][2]})", radius=2.4)
    scale = svg.color_bar(1.0, 10.0**top, "× floor", HEAT)
    note = (
        "Where the base was in all runs, coloured by the error of the nominal simulator there (logarithmic). "
        "Outlined: what stands on the ground."
    )
    return [page.card("Where on the ground", axes.svg("the base from above, coloured by the error") + scale, note)]


def _footprints(case: Case) -> list[F64]:
    """(4, 2) rectangles around all solid things that do not move, from above."""
    import mujoco

    data = mujoco.MjData(case.model)
    mujoco.mj_forward(case.model, data)
    rings = []
    for body, (V, _) in solids(case.model, data, planes=False):
        if case.model.body_weldid[body] == 0:
            (x0, y0), (x1, y1) = V.min(axis=0)[:2], V.max(axis=0)[:2]
            rings.append(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
    return rings


def _at(t: F64, time: F64, values: F64) -> F64:
    good = np.isfinite(values)
    return np.interp(t, time[good], values[good])
