"""The report's pictures, as SVG files that need no style sheet: bars of stored shares with 95 % intervals."""

from __future__ import annotations

import re

from benchmarks.tables.diagnosis import real_figures
from benchmarks.tables.fresh import measures, rows_of
from benchmarks.tables.policies import tuned_rows
from realsim.report.svg import Bar, bars
from trainer.evaluate import wilson

COLORS = {
    "c0": "#2563c9", "c1": "#d9622b", "ink": "#16191f", "soft": "#565d69", "faint": "#9aa1ad", "line": "#e3e6eb",
}  # fmt: skip
"""Those of the reports' style sheet in its light theme: a picture in Markdown has none."""
ANSWERS = {
    "exact, one cause": "one cause: `identified`, with exactly that cause",
    "exact, two causes": "two causes: `identified`, with exactly these",
    "first, one cause": "one cause, named first",
    "both of two named": "two causes, both",
    "false alarm": "nothing wrong, something named",
    "outside, reported": "outside the library, reported as such",
    "interval holds": "90 % intervals hold the truth",
}
REAL = {
    "exact, one error": "single_exact",
    "first, one error": "single_first_right",
    "both of two errors": "double_both_right",
    "surely wrong": "confident_and_wrong",
}


def pictures() -> dict[str, str]:
    """File name -> SVG."""
    answers, real = measures(rows_of()), real_figures()
    return {
        "diagnosis.svg": _shares({name: answers[title] for name, title in ANSWERS.items()}),
        "real_logs.svg": _shares({name: real[key] for name, key in REAL.items()}),
        "fine_tuning.svg": _before_and_after(),
    }


def _shares(counts: dict[str, tuple[int, int]]) -> str:
    items = []
    for name, (hits, of) in counts.items():
        low, high = wilson(hits, of)
        items.append(Bar(name, 100 * hits / of, 100 * low, 100 * high, text=f"{hits} of {of}"))
    return _alone(bars(items, x_label="% of the cases, with 95 % intervals", x=(0, 130)))


def _before_and_after() -> str:
    rows, items = tuned_rows(), []
    for test in dict.fromkeys(r["test"] for r in rows):
        mine = [r for r in rows if r["test"] == test]
        before = [100 * dict(r["evaluations"])[0] for r in mine]
        after = [100 * r["won"] / r["trials"] for r in mine]
        items.append(Bar(f"{test}, base", sum(before) / len(before), fill="var(--c1)"))
        items.append(Bar(f"{test}, tuned", sum(after) / len(after), min(after), max(after)))
    return _alone(bars(items, x_label="% of the trials that arrive; whiskers: least and most of the seeds", x=(0, 130)))


def _alone(svg: str) -> str:
    """An inline picture as a file: its colours written out, on white."""
    svg = re.sub(r"var\(--(\w+)\)", lambda m: COLORS[m[1]], svg)
    style = "<style>text{font:12px sans-serif;fill:#16191f}.grid{stroke:#e3e6eb;fill:none}</style>"
    opened = re.sub(r"^<svg", '<svg xmlns="http://www.w3.org/2000/svg" style="background:#fff"', svg, count=1)
    end = opened.index(">") + 1
    return f"{opened[:end]}{style}{opened[end:]}\n"
