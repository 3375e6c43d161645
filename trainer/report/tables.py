"""Figures of runs side by side: at their ends, and after equally long training."""

import math

import numpy as np

from realsim.report import page, svg
from trainer.report import curves
from trainer.report.curves import format_value
from trainer.report.figures import Shown, families
from trainer.report.history import LAST, Run


def percent(value: float) -> str:
    """A share of episodes."""
    return format_value(value, "share")


def runs_card(shown: Shown) -> str:
    """A row a run, at its end."""
    head = ["run", "iterations", "samples", "minutes", "samples/s", "success", "covered", "row", "last evaluation"]
    rows = []
    for run in shown.runs:
        last = "–"
        if len(run.on_the_way):
            last = f"{percent(run.on_the_way[-1, 1])} after {run.on_the_way[-1, 0]:.0f}"
        success, covered, row = _means(run)
        rows.append([run.name, *progress(run), percent(success), percent(covered), svg.number(row), last])
    note = f"Success, covered and row are means over the last {LAST} iterations, while exploring."
    return page.card("Runs", f'<div class="lines">{page.table(head, rows)}</div>', note, wide=True)


def progress(run: Run) -> list[str]:
    """Progress of a run: iterations, samples, minutes, samples per second."""
    samples, minutes = run.over.get("samples"), run.over.get("minutes")
    return [
        f"{run.over['iterations'][-1]:.0f}",
        "–" if samples is None else f"{samples[-1] / 1e6:.1f} M" if samples[-1] >= 1e6 else f"{samples[-1]:.0f}",
        "–" if minutes is None else f"{minutes[-1]:.1f}",
        svg.number(run.mean("samples a second")),
    ]


def budget_card(shown: Shown) -> str:
    """All runs after as much training as the shortest of them had, counted in what the page is drawn over."""
    tables = "".join(f'<div class="over {axis}">{_at_equal(shown, axis)}</div>' for axis in shown.reach)
    note = (
        "Success of the episodes that ended, share of the way covered, and row of the curriculum: means over the "
        f"{LAST} iterations before as much training as the shortest run had."
    )
    return page.card("After equally long training", tables, note, wide=True)


def _at_equal(shown: Shown, axis: str) -> str:
    if any(axis not in run.over for run in shown.runs):
        return f'<p class="note">Not known over {axis} for every run.</p>'
    least = min(float(run.over[axis][-1]) for run in shown.runs)
    unit, label = curves.unit_of(axis, least)
    stops = [int(np.searchsorted(run.over[axis], least * (1 + 1e-9), side="right")) for run in shown.runs]
    where = f"<h4>at {page.esc(svg.number(least / unit, 4))} {page.esc(label)}</h4>"
    rows = []
    for family in ("", *families(shown.runs)):
        each = [_means(run, family, stop) for run, stop in zip(shown.runs, stops, strict=True)]
        cells = [_three(*m) if any(map(math.isfinite, m)) else "–" for m in each]
        late = "– (its first iteration took longer)"
        rows.append([family or "all episodes", *(c if n else late for c, n in zip(cells, stops, strict=True))])
    return where + page.table(["terrain", *(run.name for run in shown.runs)], rows)


def _figures(family: str = "") -> list[str]:
    """Success, share of the way covered and row of the curriculum of a family, or of all episodes."""
    if family:
        return [f"env/family/{family}/{what}" for what in ("success", "covered", "row")]
    return ["env/success", "env/episode/covered", "env/terrain/level"]


def _means(run: Run, family: str = "", end: int | None = None) -> list[float]:
    """`_figures` over the last iterations before row `end`."""
    return [run.mean(name, end) for name in _figures(family)]


def _three(success: float, covered: float, row: float) -> str:
    return f"{percent(success)}, {percent(covered)} covered, row {svg.number(row)}"


def lines(run: Run) -> list[str]:
    """A run in a few lines for a terminal."""
    iterations, samples, minutes, speed = progress(run)
    found = [
        f"{run.name}: {iterations} iterations, {samples} samples, {minutes} min, {speed} samples/s; "
        f"success {_three(*_means(run))} (last {min(LAST, len(run))} iterations)"
    ]
    found += [f"  {family:<12} {_three(*_means(run, family))}" for family in families([run])]
    if len(run.on_the_way):
        (at, last), best = run.on_the_way[-1], run.on_the_way[:, 1].max()
        found.append(f"  evaluations  {percent(last)} after {at:.0f} iterations; the best {percent(best)}")
    return [*found, *(f"  note         {note}" for note in run.notes)]


def as_dict(run: Run) -> dict[str, object]:
    """A run for machines: where it stands, means over its last iterations, what could not be read."""
    names = [name for family in ("", *families([run])) for name in _figures(family)]
    return {
        "name": run.name,
        "folder": str(run.folder),
        **{axis: float(x[-1]) for axis, x in run.over.items()},
        "last": {name: run.mean(name) for name in names},
        "evaluations_on_the_way": run.on_the_way.tolist(),
        "notes": list(run.notes),
    }
