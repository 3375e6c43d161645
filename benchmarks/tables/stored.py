"""Rows of benchmarks/results, and what can be asked of those of the diagnosis."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from benchmarks.diagnosis import score as gap_score

RESULTS = Path(__file__).resolve().parents[1] / "results"
Row = dict[str, Any]


def stored(name: str) -> Any:
    """The content of a file of benchmarks/results."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def answered(row: Row) -> tuple[dict[str, Any], dict[str, Any]]:
    """A stored case as the label and the diagnosis that `score` scores."""

    def cause(text: str) -> dict[str, Any]:
        effect, _, places = text.partition("@")
        return {"effect": effect, "joints": [p for p in re.split(r"[+,]", places) if p], "bodies": []}

    label = {"effects": [cause(t) for t in row["truth"]], "equivalents": []}
    found = {
        "verdict": row["verdict"],
        "causes": [cause(c) for c in row["causes"]],
        "equivalent": [[cause(c) for c in group] for group in row["equivalent"]],
        "unexplained_share": row["unexplained_share"],
    }
    return label, found


def counts(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """Hits and cases of each question that can be put to stored rows."""
    by: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for row in rows:
        by.setdefault(row["cls"], []).append(answered(row))
    single, double, none = by.get("single", []), by.get("double", []), by.get("none", [])
    gaps = [*single, *double, *by.get("outside", [])]
    first = [gap_score.top1(*case) for case in single]
    both = [all(any(gap_score.hit(c, t) for c in f["causes"]) for t in x["effects"]) for x, f in double]
    return {
        "first": (sum(t == 2 for t in first), len(single)),
        "with equivalents": (sum(t >= 1 for t in first), len(single)),
        "both": (sum(both), len(double)),
        "false alarms": (sum(f["verdict"] != "no_gap" for _, f in none), len(none)),
        "missed": (sum(f["verdict"] == "no_gap" for _, f in gaps), len(gaps)),
    }


def share(pair: tuple[int, int]) -> str:
    """Hits and cases, and their share in per cent where there are twenty or more."""
    hits, of = pair
    return f"{hits} of {of}" + (f" ({hits / of:.0%})" if of >= 20 else "") if of else ""


def of(pair: tuple[int, int]) -> str:
    """Hits and cases as a table shows them."""
    return f"{pair[0]} of {pair[1]}" if pair[1] else ""


def span(values: list[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"
