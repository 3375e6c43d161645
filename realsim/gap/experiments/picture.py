"""report.html of an experiment: what each rival predicts, and where they part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from realsim.gap.experiments.choose import Looked
from realsim.gap.experiments.rivals import Rival
from realsim.gap.experiments.separation import Predicted
from realsim.gap.logs.case import Case
from realsim.gap.report.words import signal_name, unit_of
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
            page.card("What each rival predicts", _curves(case, best.predicted, len(rivals)), _CURVES, wide=True),
            page.card("The commands", _commands(case, best.predicted), wide=True),
        ),
    ]
    return page.document(f"Experiment for {case.folder.name}", plan["title"], "".join(body))


_NOTE = (
    "Expected probability of the true rival after the recording; and the log Bayes factor that the hardest pair of "
    "rivals may expect. Everyday deviations were simulated for the first few only: the others are rather too good."
)
_CURVES = (
    "By run, the signals in which the rivals part most, in units of the noise floor: the prediction of every rival "
    "minus that of A. What lies within the stripe is noise."
)


def _table(looked: Sequence[Looked]) -> str:
    rows = []
    for one in looked:
        if one.refused:
            rows.append([one.title, "-", "-", one.refused])
        else:
            said = "everyday deviations included" if one.with_deviations else ""
            rows.append([one.title, f"{one.posterior:.2f}", f"{one.worst / 2:.1f}", said])
    return page.table(["excitation", "probability", "log Bayes factor", ""], rows)


def _curves(case: Case, predicted: Predicted, count: int) -> str:
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
    parts = []
    for _, run, c, changes, floor in found[:PLOTS]:
        channel = comparison.channels[c]
        step = max(1, len(floor) // POINTS)
        t = comparison.times[run][::step]
        unit = unit_of(channel.signal, channel.label, case.model)
        every = np.concatenate([d[::step, c] for d in changes])
        half = 1.1 * max(float(np.abs(every).max()), 3 * float(np.median(floor[:, c])))
        axes = svg.Axes((float(t[0]), float(t[-1])), (-half, half), x_label="time, s", y_label=unit, height=190, left=58)
        two = 2 * float(np.median(floor[:, c]))
        axes.span(-two, two, "var(--faint)")
        for i in range(count):
            axes.polyline(np.column_stack([t, changes[i][::step, c]]), svg.color(i), width=1.6)
            axes.legend(chr(65 + i), svg.color(i))
        title = f"{channel.label}, {signal_name(channel.signal)}, {predicted.experiment.runs[run].name}"
        parts.append(f"<h4>{page.esc(title)}</h4>" + axes.svg(title))
    return "".join(parts)


def _commands(case: Case, predicted: Predicted) -> str:
    parts = []
    for run in predicted.experiment.runs:
        step = max(1, len(run.time) // POINTS)
        series = [
            svg.Series(name, run.time[::step], run.command[::step, u]) for u, name in enumerate(case.actuator_names[:8])
        ]
        parts.append(f"<h4>{page.esc(run.name)}</h4>" + svg.line(series, x_label="time, s", y_label="command"))
    return "".join(parts)
