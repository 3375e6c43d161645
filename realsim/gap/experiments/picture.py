"""report.html of an experiment: what each rival predicts, and where they part."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from realsim.core.types import F64
from realsim.gap.case.case import Case
from realsim.gap.case.model.channels import unit_of
from realsim.gap.experiments.choose import Looked
from realsim.gap.experiments.rivals import Rival
from realsim.gap.experiments.separation import Predicted
from realsim.gap.report.overlays import LEFT, differences
from realsim.gap.report.words import signal_name
from realsim.report import page, svg

PLOTS, POINTS = 4, 500
"""Signals that are drawn, those first in which the rivals part most; and points of a curve."""


def page_of(case: Case, looked: Sequence[Looked], rivals: Sequence[Rival], plan: Mapping[str, Any]) -> str:
    """The whole page as text."""
    best = looked[0]
    assert best.predicted is not None
    names = [f"{chr(65 + i)}: {r.says}" for i, r in enumerate(rivals)]
    level: Any = "good" if best.decides else "look"
    body = [
        page.verdict(level, f"Record {plan['text']}.", names),
        page.grid(
            page.card("What to do", page.bullets(plan["instructions"])),
            page.card("Excitations that were looked at", _table(looked), _NOTE),
        ),
        page.grid(
            page.card("What each rival predicts", _curves(case, best.predicted), _CURVES, wide=True),
            page.card("The commands", _commands(case, best.predicted), wide=True),
        ),
    ]
    return page.document(f"Experiment for {case.folder.name}", plan["title"], "".join(body))


_NOTE = (
    "Expected probability of the true rival after the recording; and the log Bayes factor that the hardest pair of "
    "rivals may expect. Everyday deviations were simulated for the first few only: the others are rather too good."
)
_CURVES = (
    "The signals in which the rivals part most; below each, the prediction of every rival minus that of A (in the "
    "stripe: within twice the noise floor)."
)
_TWO = 'class="grid" style="grid-template-columns:repeat(auto-fit,minmax(min(380px,100%),1fr))"'


def _table(looked: Sequence[Looked]) -> str:
    rows = []
    for one in looked:
        if one.refused:
            rows.append([one.title, "-", "-", one.refused])
        else:
            remark = "everyday deviations included" if one.with_deviations else ""
            rows.append([one.title, f"{one.posterior:.2f}", f"{one.worst / 2:.1f}", remark])
    return page.table(["excitation", "probability", "log Bayes factor", ""], rows)


def _curves(case: Case, predicted: Predicted) -> str:
    """Differences between the rivals, of the signals in which they part most."""
    comparison = predicted.comparison
    found = []
    for run in range(len(predicted.experiment.runs)):
        changes = [comparison.change(run, m[run], predicted.motions[0][run]) for m in predicted.motions]
        floor = np.sqrt(comparison.floor(run))
        for c in range(len(comparison.channels)):
            size = max(float(np.sqrt(np.mean((d[:, c] / floor[:, c]) ** 2))) for d in changes)
            found.append((size, run, c, changes, floor))
    found.sort(key=lambda f: -f[0])
    parts = [_pair(case, predicted, run, c, changes, floor) for _, run, c, changes, floor in found[:PLOTS]]
    legend = page.legend([(chr(65 + i), svg.color(i)) for i in range(len(predicted.motions))])
    return f"<div {_TWO}>{''.join(parts)}</div>{legend}"


def _pair(case: Case, predicted: Predicted, run: int, c: int, changes: Sequence[F64], floor: F64) -> str:
    """One signal: the rivals' predictions, and below what they differ by."""
    comparison = predicted.comparison
    channel, planned = comparison.channels[c], predicted.experiment.runs[run]
    fine = max(1, len(planned.time) // POINTS)
    span = (float(planned.time[0]), float(planned.time[-1]))
    curves = [m[run][::fine, c] for m in predicted.motions]
    unit = unit_of(channel.signal, channel.label, case.model)
    every = svg.padded(np.concatenate(curves), 0.08)
    top = svg.Axes(span, every, y_label=unit, height=170, left=LEFT, bottom=8, x_ticks=[])
    for i, y in enumerate(curves):
        dash = "6 3" if i else ""
        top.polyline(np.column_stack([planned.time[::fine], y]), svg.color(i), width=1.8, dash=dash)
    colored = [(d[:, c], svg.color(i)) for i, d in enumerate(changes)]
    low = differences(comparison.times[run], colored, 2 * float(np.median(floor[:, c])), span, "difference")
    title = f"{channel.label}, {signal_name(channel.signal)}, {planned.name}"
    return f"<div><h4>{page.esc(title)}</h4>{top.svg(title)}{low}</div>"


def _commands(case: Case, predicted: Predicted) -> str:
    parts = []
    for run in predicted.experiment.runs:
        step = max(1, len(run.time) // POINTS)
        series = [
            svg.Series(name, run.time[::step], run.command[::step, u]) for u, name in enumerate(case.actuator_names[:8])
        ]
        plot = svg.line(series, x_label="time, s", y_label="command", height=190)
        parts.append(f"<div><h4>{page.esc(run.name)}</h4>{plot}</div>")
    return f"<div {_TWO}>{''.join(parts)}</div>"
