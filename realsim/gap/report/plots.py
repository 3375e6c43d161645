"""The three plots of the first screen: where, what, how much."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from realsim.core.statistics import Z90
from realsim.gap.answer.arrays import Arrays
from realsim.gap.answer.brief import on_what
from realsim.gap.answer.diagnosis import Diagnosis
from realsim.gap.answer.sentence import amount
from realsim.gap.inference.evidence.where import PHASES
from realsim.gap.report.series import horizons, place_shares
from realsim.gap.report.words import NOT_KEPT, after, percent, places, short, signal_name, title_of
from realsim.report import page, svg

WIDTH = 340
"""SVG units; about the width of a third of the page, and of a phone."""
_CHANNELS, _ROWS, _RIVALS = 9, 13, 7
_LINE = 58
"""Characters that fit above a bar."""
_PHASE_LABELS = {"at rest": "rest", "reversal": "turns", "fast forward": "fast\u00a0+", "fast backward": "fast\u00a0−"}
LEAST_SHOWN = -0.08
"""Of the best gain: bars of effects that make things worse end here."""
FOUND, RIVAL, OTHER = "var(--good)", "var(--look)", "var(--faint)"


# ---------------------------------------------------------------- where


def where_card(found: Diagnosis) -> str:
    """A heat map: joint (or signal of the base) by phase of motion, and shares by signal."""
    if found.evidence is None:
        return page.card("Where", page.bullets([], NOT_KEPT))
    rows = _rows(found.evidence)
    if len(rows) > _ROWS:
        rest = np.sum([r for _, r in rows[_ROWS - 1 :]], axis=0)
        rows = [*rows[: _ROWS - 1], (f"{len(rows) - _ROWS + 1} others", rest)]
    note = "Share of the squared error above the noise floor, percent, by place and phase of motion."
    if found.verdict == "no_gap":
        note = "Where the little error above the noise floor lies; it is too small to be a gap."
    return page.card("Where", _heat(rows, PHASES) + _by_signal(found), note)


def _rows(kept: Arrays) -> list[tuple[str, Any]]:
    """(name, (phases,) shares), largest first: one a channel where that is few, else one a joint."""
    channels, shares = kept.channels, kept.shares
    if len(channels) <= _CHANNELS:
        labels = [f"{_brief(c.label, 12)} {signal_name(c.signal).removeprefix('joint ')}" for c in channels]
    else:
        names, shares = place_shares(kept)
        labels = [_brief(name) if kind == "joint" else signal_name(name) for kind, name in names]
    return [(labels[i], shares[i]) for i in np.argsort(-shares.sum(axis=1), kind="stable")]


def _brief(joint: str, most: int = 17) -> str:
    """A joint's name for the narrowest place."""
    return short(joint.replace("left_", "L_").replace("right_", "R_"), most)


def _heat(rows: Sequence[tuple[str, Any]], columns: Sequence[str]) -> str:
    n, m = len(rows), len(columns)
    height = 27 if n < 7 else 23 if n < 10 else 19
    left = 10 + 5.7 * max(len(name) for name, _ in rows)
    labels = [(n - i - 0.5, name) for i, (name, _) in enumerate(rows)]
    axes = svg.Axes((0, m + 1.05), (0, n), width=WIDTH, height=height * n + 26, left=left, right=0, top=4, bottom=22,
                    x_ticks=[], y_ticks=labels, grid=False)  # fmt: skip
    top = max(float(np.max([r for _, r in rows])), 1e-9)
    for i, (name, row) in enumerate(rows):
        y = n - i
        for j, share in enumerate(row):
            ring = [(j + 0.03, y - 0.04), (j + 0.97, y - 0.04), (j + 0.97, y - 0.96), (j + 0.03, y - 0.96)]
            axes.polyline(ring, "none", fill="var(--line)", closed=True, opacity=0.55)
            text = f"{name}, {columns[j]}: {percent(share)}"
            strength = 0.95 * math.sqrt(max(share, 0) / top)
            axes.polyline(ring, "none", fill="var(--c1)", closed=True, opacity=round(strength, 3), title=text)
            if share >= 0.005:
                axes.text(j + 0.5, y - 0.5, f"{100 * share:.0f}", fill="var(--ink)", dy=4)
        axes.text(m + 1.0, y - 0.5, percent(float(np.sum(row))), fill="var(--ink)", anchor="end", dy=4)
    for j, name in enumerate(columns):
        for k, word in enumerate(_PHASE_LABELS.get(name, name).split(" ")):
            axes.text(j + 0.5, 0, word, dy=13 + 12 * k, outside=True)
    axes.text(m + 1.0, 0, "all", anchor="end", dy=13, outside=True)
    return axes.svg("share of the gap by place and phase of motion")


def _by_signal(found: Diagnosis) -> str:
    parts = [(s, v) for s, v in found.statistics.get("by_signal", {}).items() if v > 0.001]
    if len(parts) < 2:
        return ""
    axes = svg.Axes((0, sum(v for _, v in parts)), (0, 1), width=WIDTH, height=14, left=0, right=0, top=2, bottom=0,
                    x_ticks=[], y_ticks=[], grid=False)  # fmt: skip
    at = 0.0
    for i, (signal, share) in enumerate(parts):
        ring = [(at, 0), (at + share, 0), (at + share, 1), (at, 1)]
        axes.polyline(ring, "var(--card)", fill=svg.color(i), closed=True)
        axes.legend(f"{signal_name(signal)} {percent(share)}", svg.color(i))
        at += share
    return axes.svg("share of the gap by signal")


# ---------------------------------------------------------------- what


def what_card(found: Diagnosis) -> str:
    """The best effects that were fitted, by what they gain on runs left out of the fit where all were judged so."""
    left_out = all(r.get("heldout_gain") is not None for r in found.ranking if r.get("gain") is not None)
    by = "heldout_gain" if left_out else "gain"
    tried = [r for r in found.ranking if r.get(by) is not None]
    if not tried:
        empty = "No effect had to be fitted: what differs is within the noise floor and everyday deviations."
        screened = sum("linear_gain" in r for r in found.ranking)
        none = f"None of the {screened} effects that were screened explains enough of the error to be fitted."
        return page.card("What", page.bullets([], empty if found.verdict == "no_gap" else none))
    here = {c["effect"] for c in found.causes}
    same = {c["effect"] for s in found.equivalent for c in s} - here
    first = [r for r in tried if r["effect"] in here | same]
    first.sort(key=lambda r: (r["effect"] not in here, -r[by]))
    others = sorted((r for r in tried if r not in first), key=lambda r: -r[by])
    rows = [*first, *others][:_RIVALS]
    bars = []
    best = max(max(r[by] for r in rows), 1e-9)
    for r in rows:
        kind = FOUND if r["effect"] in here else RIVAL if r["effect"] in same else OTHER
        mark = {FOUND: "✓ ", RIVAL: "≈ "}.get(kind, "")
        label = rival_label(mark, r)
        spread = Z90 * (r.get("heldout_se") or 0.0) / best if left_out else 0.0
        value = max(r[by] / best, LEAST_SHOWN)
        bars.append((label, value, value - spread, value + spread, kind, _relative(r[by] / best)))
    end = 1.25 * min(max(b[3] for b in bars), 2.0)
    per = 2 if end > 1.5 else 4
    # None at the end: its text would stand beyond the plot.
    ticks = [(k / per, f"{100 * k // per} %") for k in range(math.ceil(per * end))]
    picture = _labelled_bars(bars, (-0.1 * end, end), "", ticks)
    legend = [("in the diagnosis", FOUND)] if here else []
    legend += [("explains the log as well", RIVAL)] if same else []
    legend.append(("other effects", OTHER))
    how = "predicts runs left out of the fit" if left_out else "explains the fitted runs"
    note = f"How well each effect alone, fitted at its best place, {how}; 100 % is the best one."
    note += " Whiskers are 90 %." if left_out else ""
    return page.card("What", picture + page.legend(legend), note)


def _relative(value: float) -> str:
    """Share of the best effect's gain; what makes it worse is none."""
    return percent(value) if value > 0 else "no better"


def rival_label(mark: str, r: dict[str, Any]) -> str:
    """Effect, places and stage on one line: fewer places are named where the line would not hold them."""
    stage = f", {after(r['stage'])}" if r.get("stage") else ""
    names = [short(n, 14) for n in r.get("place", [])]
    for most in (2, 1):
        text = f"{mark}{title_of(r['effect'])} · {places(names, most)}{stage}"
        if len(text) <= _LINE:
            return text
    return text if len(text) <= _LINE else text[: _LINE - 1] + "…"


def _labelled_bars(
    rows: Sequence[tuple[str, float, float, float, str, str]],
    x: tuple[float, float],
    x_label: str,
    x_ticks: Sequence[tuple[float, str]] | None = None,
) -> str:
    """Bars with their names above: (name, value, low, high, fill, text). Names get the whole width that way."""
    n = len(rows)
    axes = svg.Axes(x, (-0.5, n - 0.5), width=WIDTH, height=38 * n + (38 if x_label else 22), left=4, right=4,
                    top=2, bottom=36 if x_label else 20, y_ticks=[], x_label=x_label, x_ticks=x_ticks)  # fmt: skip
    room = x[1] - 0.17 * (x[1] - x[0])
    for i, (name, value, low, high, fill, text) in enumerate(rows):
        y = n - 1 - i
        axes.text(x[0], y, name, fill="var(--ink)" if fill != OTHER else "var(--soft)", anchor="start", dx=3, dy=-6)
        axes.polyline([(0, y - 0.42), (0, y + 0.02)], OTHER, width=1)
        end = 0.0
        if math.isfinite(value):
            axes.bar(y - 0.2, min(value, x[1]), fill, thickness=0.3, title=f"{name}: {text}")
            if high > low:
                axes.whisker(y - 0.2, max(low, x[0]), min(high, room), "var(--ink)")
            end = min(max(value, high, 0.0), room)
        beyond = max(value, high) > room  # the bar takes the whole width: its figure stands on the line above
        place = (x[1], y, "end", -3, -6) if beyond else (end, y - 0.2, "start", 6, 4)
        axes.text(place[0], place[1], text, fill="var(--ink)", anchor=place[2], dx=place[3], dy=place[4])
    return axes.svg(x_label)


# ---------------------------------------------------------------- how much


_READING = {
    "one sample": "Half of it is there after one sample, as with readings and their delays.",
    "20 ms": "Half of it is there within 20 ms, as with drives (gains, delays, limits) or a wrong pose on the ground.",
    "100 ms": "Half of it takes about 100 ms, as with forces that are missing (friction, inertia, load).",
    "500 ms": "Half of it takes half a second, as with slow forces (load, contact, compliance) or drift.",
}


def how_much_card(found: Diagnosis) -> str:
    """Error of the check before and after: all together, and for each signal and horizon."""
    shrunk = found.shrinkage
    rows = [("nominal simulator", 1.0, 1.0, 1.0, OTHER, "100 %")]
    if found.causes:
        low, high = (1 - v for v in reversed(shrunk["ci90"]))
        rows.append(("✓ with this diagnosis", shrunk["after"], low, high, FOUND, percent(shrunk["after"])))
    note = f"Squared error left {on_what(shrunk)}."
    end = 1.22 * max(1.0, *(min(high, 1.4) for _, _, _, high, _, _ in rows if math.isfinite(high)))
    ticks = [(k / 4, f"{25 * k} %") for k in range(int(4 * end) + 1)]
    if found.evidence is not None:
        note += " Below: before and after, over whole runs, and of joint positions predicted from estimated states."
        rows_ahead = horizons(found.evidence)
        top = max((before for _, before, _ in rows_ahead), default=0.0)
        if top >= 2:
            note += " " + _READING.get(next(label for label, before, _ in rows_ahead if before >= 0.5 * top), "")
    body = _labelled_bars(rows, (-0.02, end), "", ticks) + _table(found) + _before_after(found)
    return page.card("How much", body, note)


def _table(found: Diagnosis) -> str:
    """Before and after in the signals' own units, beside the size of the motion."""
    rows = []
    for signal, v in found.shrinkage.get("per_signal", {}).items():
        after = amount(v["rms_after"], v["unit"]) if found.causes else "–"
        rows.append([signal_name(signal), amount(v["rms_before"], v["unit"]), after, amount(v["motion"], v["unit"])])
    return page.table(["rms error", "before", "after", "motion"], rows) if rows else ""


def _before_after(found: Diagnosis) -> str:
    """Root mean square by signal and by horizon, in units of the noise floor, on a logarithmic axis."""
    rows: list[tuple[str, float, float | None]] = []
    for signal, v in found.shrinkage.get("per_signal", {}).items():
        after = v["rms_after"] / v["floor"] if found.causes else None
        rows.append((signal_name(signal), v["rms_before"] / v["floor"], after))
    rows += [(f"joints, {name} ahead", b, a) for name, b, a in horizons(found.evidence)]
    values = [v for _, b, a in rows for v in (b, a) if v is not None and v > 0]
    if not values:
        return ""
    n = len(rows)
    labels = [(n - 1 - i, r[0]) for i, r in enumerate(rows)]
    low, high = math.log10(min([0.7, *values])) - 0.1, math.log10(max([3.0, *values])) + 0.15
    steps = (1, 2, 5) if high - low < 2 else (1,)
    tens = [(math.log10(m) + k, svg.number(m * 10.0**k)) for k in range(-2, 7) for m in steps]
    tens = [t for t in tens if low <= t[0] <= high]
    axes = svg.Axes((low, high), (-0.6, n - 0.4), width=WIDTH, height=21 * n + 42, top=4, right=4,
                    left=12 + 6.0 * max(len(name) for _, name in labels), x_ticks=tens, y_ticks=labels,
                    x_label="error / noise floor (log)")  # fmt: skip
    axes.span(low, 0.0, FOUND, vertical=True)
    for i, (name, before, after) in enumerate(rows):
        y = n - 1 - i
        b = math.log10(max(before, 1e-9))
        if after is not None and after > 0:
            a = math.log10(after)
            axes.polyline([(a, y), (b, y)], OTHER, width=2)
            axes.dots([(a, y)], FOUND, radius=4.2, titles=[f"{name}: after {svg.number(after)}"])
        axes.dots([(b, y)], "var(--c1)", radius=4.2, titles=[f"{name}: before {svg.number(before)}"])
    axes.legend("before", "var(--c1)")
    if found.causes:
        axes.legend("after", FOUND)
    axes.legend("within the noise floor", f"color-mix(in srgb, {FOUND} 22%, transparent)")
    return axes.svg("error by signal and horizon in units of the noise floor")
