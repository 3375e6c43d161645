"""The tables of figures in README.md and docs, made from benchmarks/results.

    python -m benchmarks.tables           # writes them between their marks
    python -m benchmarks.tables --check   # exit code 1 if a page differs from what is stored

A table stands between `<!-- figures: NAME -->` and `<!-- end -->`. Nothing is selected by outcome: the diagnosis has a
row for every seed and engine that was measured on cases unknown to its development, and their sum.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.tables.api import functions
from benchmarks.tables.captures import captures, clouds, contact, damaged, hard_matches, loops, movers, real_captures
from benchmarks.tables.diagnosis import (
    bags,
    closing,
    diagnosis_by_robot,
    diagnosis_by_set,
    diagnosis_intervals,
    drift,
    experiments,
    footholds,
    real_logs,
    sweep,
    times,
    unstable,
)
from benchmarks.tables.fresh import by_robot, fresh
from benchmarks.tables.index import index
from benchmarks.tables.policies import (
    all_reconstructed,
    base,
    by_pushes,
    by_worlds,
    kept,
    pushed,
    quadruped_base,
    reconstructed,
    strategies,
    tuned,
)
from benchmarks.tables.readme import readme

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README.md",
    "docs/figures.md",
    "docs/gap_figures.md",
    "docs/captures.md",
    "docs/api.md",
    "benchmarks/results/README.md",
)
TABLES: dict[str, Callable[[], list[str]]] = {
    "readme": readme,
    "functions": functions,
    "captures": captures,
    "contact": contact,
    "real captures": real_captures,
    "clouds": clouds,
    "loops": loops,
    "movers": movers,
    "hard matches": hard_matches,
    "bags": bags,
    "diagnosis by set": diagnosis_by_set,
    "diagnosis by robot": diagnosis_by_robot,
    "diagnosis by seed": diagnosis_intervals,
    "fresh seed": fresh,
    "fresh seed by robot": by_robot,
    "base policy": base,
    "pushes": pushed,
    "base policy of the quadruped": quadruped_base,
    "test-time training": tuned,
    "kept with pushes": kept,
    "test-time training on reconstructions": reconstructed,
    "test-time training on all reconstructions": all_reconstructed,
    "test-time training by worlds": by_worlds,
    "test-time training by pushes": by_pushes,
    "test-time training by strategy": strategies,
    "footholds": footholds,
    "damaged": damaged,
    "real logs": real_logs,
    "unstable robots": unstable,
    "sweep": sweep,
    "times": times,
    "experiments": experiments,
    "drift": drift,
    "closing the loop": closing,
    "index": index,
}
MARKED = re.compile(r"(<!-- figures: ([a-z -]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with its tables as they are stored."""
    return MARKED.sub(lambda m: m[1] + "\n".join(TABLES[m[2]]()) + "\n" + m[3], text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = [page for page in PAGES if filled((ROOT / page).read_text()) != (ROOT / page).read_text()]
    for page in stale:
        if check:
            print(f"{page} differs from benchmarks/results: make readme", file=sys.stderr)
        else:
            (ROOT / page).write_text(filled((ROOT / page).read_text()))
            print(f"{page} written")
    return int(bool(stale) and check)
