"""The tables of figures in README.md and docs, made from benchmarks/results.

    python -m benchmarks.tables           # writes them between their marks
    python -m benchmarks.tables --check   # exit code 1 if a page differs from what is stored

A table is between `<!-- figures: NAME -->` and `<!-- end -->`. benchmarks/results holds the rows of one engine, all of
them; rows of earlier ones are in the history of git. The pictures of the report are made from the same rows.
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.diagnosis import unstable
from benchmarks.scenes import loops
from benchmarks.tables import diagnosis, fresh, index, plots, policies, readme, scenes
from benchmarks.tables.api import functions
from benchmarks.tables.stored import stored
from benchmarks.training import base_policy, ladder, pushes, trials

ROOT = Path(__file__).resolve().parents[2]
PLOTS, IMAGES = ROOT / "benchmarks" / "plots", ROOT / "docs" / "images"
PAGES = ("README.md", "benchmarks/REPORT.md", "docs/api.md", "benchmarks/results/README.md", "trainer/policies/CARD.md")
TABLES: dict[str, Callable[[], list[str]]] = {
    "readme": readme.readme,
    "functions": functions,
    "index": index.index,
    "captures": scenes.captures,
    "scale": scenes.scale,
    "contact": lambda: list(stored("contact")["summary"]),
    "real captures": scenes.real_captures,
    "clouds": scenes.clouds,
    "loops": lambda: loops.table(stored("loops")["rows"]),
    "movers": scenes.movers,
    "hard matches": scenes.hard_matches,
    "damaged": scenes.damaged,
    "fresh seed": fresh.fresh,
    "fresh seed by robot": fresh.by_robot,
    "real logs": diagnosis.real_logs,
    "unseen robots": diagnosis.unseen,
    "unstable robots": lambda: unstable.table(stored("gap_unstable")["rows"]),
    "sweep": diagnosis.sweep,
    "times": diagnosis.times,
    "experiments": diagnosis.experiments,
    "drift": diagnosis.drift,
    "footholds": diagnosis.footholds,
    "closing the loop": diagnosis.closing,
    "beside the paper": policies.beside_the_paper,
    "base policy": lambda: base_policy.table(stored("base_policy")["rows"]),
    "base policy of go2": lambda: base_policy.table(stored("base_policy")["rows"], "go2"),
    "base policy of the quadruped": lambda: base_policy.table(stored("base_policy")["rows"], "quadruped"),
    "pushes": lambda: pushes.table(stored("pushes")["rows"]),
    "tests": policies.tests,
    "all tests at once": policies.all_at_once,
    "in a minute": policies.in_a_minute,
    "tuned captures": policies.tuned_captures,
    "worlds": lambda: policies.means("worlds", stored("ttt_worlds")["rows"]),
    "help": lambda: ladder.table(stored("ladder")["rows"]),
    "trials": lambda: trials.table(stored("trials")["rows"], "g1"),
    "clean meshes": scenes.clean_meshes,
    "recordings": scenes.recordings,
    "strategies": policies.strategies,
}
MARKED = re.compile(r"(<!-- figures: ([a-z0-9 -]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(text: str) -> str:
    """A page with its tables as they are stored."""
    return MARKED.sub(lambda m: m[1] + "\n".join(TABLES[m[2]]()) + "\n" + m[3], text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    made = {ROOT / page: filled((ROOT / page).read_text()) for page in PAGES}
    made |= {PLOTS / name: picture for name, picture in plots.pictures().items()}
    made |= {IMAGES / name: picture for name, picture in plots.pictures_of_docs().items()}
    stale = [file for file, text in made.items() if not file.is_file() or file.read_text() != text]
    for file in stale:
        if check:
            print(f"{file.relative_to(ROOT)} differs from benchmarks/results: make readme", file=sys.stderr)
        else:
            file.parent.mkdir(exist_ok=True)
            file.write_text(made[file])
            print(f"{file.relative_to(ROOT)} written")
    return int(bool(stale) and check)
