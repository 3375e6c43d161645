"""The tables of figures in README.md and docs/figures.md, made from benchmarks/results.

    python -m benchmarks.tables           # writes them between their marks
    python -m benchmarks.tables --check   # exit code 1 if a page differs from what is stored

A table stands between `<!-- figures: NAME -->` and `<!-- end -->`. Nothing is selected by outcome: the diagnosis has a
row for every seed and engine that was measured on cases unknown to its development, and their sum.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import base_policy, gap_score, reconstruct

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = ("README.md", "docs/figures.md", "benchmarks/results/README.md")
Row = dict[str, Any]


def stored(name: str) -> Any:
    """The content of a file of benchmarks/results."""
    return json.loads((RESULTS / f"{name}.json").read_text())


# ---------------------------------------------------------------- the diagnosis


def answered(row: Row) -> tuple[dict[str, Any], dict[str, Any]]:
    """A stored case as the label and the diagnosis that `gap_score` scores."""

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


def of(pair: tuple[int, int]) -> str:
    """Hits and cases as a table shows them."""
    return f"{pair[0]} of {pair[1]}" if pair[1] else ""


def diagnosis_by_set() -> list[str]:
    """A row for every seed and engine, and one for all of them."""
    rows = stored("diagnosis")["rows"]
    sets: dict[tuple[int, str], list[Row]] = {}
    for row in rows:
        sets.setdefault((row["seed"], row["commit"]), []).append(row)
    lines = [
        "| seed, engine | robots (cases) | one cause: first | or equivalent | two causes: both "
        "| false alarms | missed gaps |",
        "|---|---|---|---|---|---|---|",
    ]
    for (seed, commit), part in sets.items():
        lines.append(f"| {seed}, {commit} | {robots(part)} | {_cells(part)} |")
    return [*lines, f"| all | {len(rows)} cases | {_cells(rows)} |"]


def diagnosis_by_robot() -> list[str]:
    """The same cases by robot."""
    rows = stored("diagnosis")["rows"]
    lines = [
        "| robot | cases | one cause: first | or equivalent | two causes: both | false alarms | missed gaps |",
        "|---|---|---|---|---|---|---|",
    ]
    for robot in ("pendulum", "arm2", "arm6", "quadruped", "g1"):
        part = [row for row in rows if row["robot"] == robot]
        lines.append(f"| {robot} | {len(part)} | {_cells(part)} |")
    return lines


def _cells(rows: list[Row]) -> str:
    return " | ".join(of(pair) for pair in counts(rows).values())


def robots(rows: list[Row]) -> str:
    """Robots of some cases, and how many cases of each."""
    names = [row["robot"] for row in rows]
    return ", ".join(f"{name} {names.count(name)}" for name in dict.fromkeys(sorted(names)))


def diagnosis_intervals() -> list[str]:
    """What is stored of a seed as a whole."""
    lines = [
        "| seed | 90 % intervals that hold the truth | cause outside the library: said | look-alikes: said "
        "| share of the gap removed on the run held out, median, right cause |",
        "|---|---|---|---|---|",
    ]
    for s in stored("diagnosis")["sets"]:
        gone = 100 * s["gap_gone_median_where_right"]
        cells = (of(s["ci90_holds_truth"]), of(s["outside_said"]), of(s["confounded_named"]), f"{gone:.1f} %")
        lines.append(f"| {s['seed']} | {' | '.join(cells)} |")
    return lines


# ---------------------------------------------------------------- the README


def readme() -> list[str]:
    """The README's one table: at most eight rows, each with the section of docs/figures.md that it is from."""
    scenes = {
        mode: [
            r for r in stored("reconstruct")["rows"]
            if r["capture"] in reconstruct.NAMES and r["method"] == f"realsim, poses {mode}"
        ]
        for mode in reconstruct.MODES
    }  # fmt: skip
    latest = [row for row in stored("diagnosis")["rows"] if row["seed"] == 101]
    every = counts(stored("diagnosis")["rows"])
    fresh = counts(latest)
    contact = next(line for line in stored("contact")["summary"] if line.startswith("| `auto` | 13 exact")).split("|")
    seconds = [r["seconds"] for rows in scenes.values() for r in rows]
    rows = [
        (
            "Scene: height of obstacles, camera poses given / unknown",
            " / ".join(f"{_span([r['delivered_tops_mm'] for r in rows], '{:.1f}')} mm" for rows in scenes.values()),
            "3 rendered captures with sensor noise",
        ),
        (
            "Scene: error of scale, camera poses given / unknown",
            " / ".join(f"{_span([100 * r['scale_error'] for r in rows], '{:.2f}')} %" for rows in scenes.values()),
            "the same; without poses the sensor's own error stays",
        ),
        (
            "Scene: from frames to a checked scene",
            f"{_span(seconds, '{:.0f}')} s",
            "60 frames, two cores, no GPU",
        ),
        (
            "Contact: deviation from the mesh, median / 95th percentile, worst mesh",
            f"{contact[3].strip()} / {contact[4].strip()} mm",
            "13 meshes, measured with balls in MuJoCo",
        ),
        (
            "Diagnosis: a single cause is named first / or as an equivalent",
            f"{of(fresh['first'])} / {of(fresh['with equivalents'])}",
            f"seed 101; on all {len(stored('diagnosis')['rows'])} cases "
            f"{of(every['first'])} / {of(every['with equivalents'])}",
        ),
        (
            "Diagnosis: both of two causes are found",
            of(fresh["both"]),
            f"seed 101; on all cases {of(every['both'])}",
        ),
        (
            "Diagnosis: a cause is named where nothing is wrong",
            of(fresh["false alarms"]),
            f"seed 101; on all cases {of(every['false alarms'])}",
        ),
        (
            "Policy: G1 crosses unseen courses of difficulty 0.5 / 0.8, mean and worst of six families",
            " / ".join(_families(difficulty) for difficulty in ("0.5", "0.8")),
            "the base that ships, not fine-tuned, in simulation; 23 minutes of training on one H200",
        ),
    ]
    return ["| | figure | measured on |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]


def _families(difficulty: str) -> str:
    groups = base_policy.grouped(stored("base_policy")["rows"])
    shares = [100 * won / of for name, (won, of) in groups.items() if name.endswith(f":{difficulty}")]
    return f"{sum(shares) / len(shares):.0f} and {min(shares):.0f} %"


def base() -> list[str]:
    """The base policy on every family, difficulty and test."""
    return base_policy.table(stored("base_policy")["rows"])


def _span(values: list[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def captures() -> list[str]:
    """Errors of reconstructed captures with exact truth."""
    head = [
        "| capture, camera poses | scale | tilt | heading | origin | tops, as delivered | F-score at 1 cm / 2 cm |",
        "|---|---|---|---|---|---|---|",
    ]
    return head + reconstruct.readme_table(stored("reconstruct")["rows"])


def contact() -> list[str]:
    """Measured contact by representation."""
    return list(stored("contact")["summary"])


# ---------------------------------------------------------------- the index

INDEX = (
    ("Scenes against exact truth, and against two real captures", "reconstruct", "python benchmarks/reconstruct.py"),
    (
        "Time and memory by the number of frames",
        "reconstruct_scaling",
        "python benchmarks/reconstruct.py --frames N ...",
    ),
    ("Error of the metric scale by source of points and poses", "scale_error", "python benchmarks/scale_error.py"),
    ("Contact against the mesh, by representation", "contact", "python benchmarks/contact.py"),
    ("Diagnosis of generated cases, labels withheld", "diagnosis", "python benchmarks/gap_withheld.py --seed SEED"),
    (
        "Diagnosis of real logs with known errors in their models",
        "gap_real",
        "python benchmarks/gap_real.py score --part report",
    ),
    ("Diagnosis beside mujoco.sysid", "gap_sysid", "python benchmarks/gap_sysid.py"),
    ("Speed of training", "trainer_speed", "python benchmarks/trainer_speed.py"),
    ("Learning on one CPU core", "trainer_cpu", "python benchmarks/trainer_cpu.py"),
    ("First learning rate of fine-tuning", "trainer_tune", "python benchmarks/trainer_tune.py"),
    ("Places that repeat, and an unregistered Kinect", "captures", "python benchmarks/captures.py"),
    ("Mistakes between a policy and its robot", "gap_contract", "python benchmarks/gap_contract.py --seed 2000"),
    ("The base policy without fine-tuning", "base_policy", "python benchmarks/base_policy.py"),
    (
        "Pretraining and fine-tuning on one GPU, an earlier recipe",
        "training_gpu",
        "realsim pretrain, realsim finetune (in the file)",
    ),
)


def index() -> list[str]:
    """A row for every file: claim, command, commit, date, machine; what a file does not say is said to be unknown."""
    lines = ["| claim | file | command | commit | date | machine |", "|---|---|---|---|---|---|"]
    for claim, name, command in INDEX:
        commit, machine = _made(stored(name))
        commit = commit or f"added by {ADDED[name][1]}"
        lines.append(f"| {claim} | {name}.json | `{command}` | {commit} | {_date(name)} | {machine} |")
    return lines


def _made(data: Any) -> tuple[str, str]:
    runs = list(data["runs"].values()) if isinstance(data.get("runs"), dict) else [data["run"]] if "run" in data else []
    commits = [r["commit"] for r in runs if r.get("commit")] or [
        r["commit"] for r in data.get("rows", ()) if "commit" in r
    ]
    cpus = [f"{r['cores']} cores, {r['cpu']}" for r in runs] or [
        f"{s['scored_by']['cores']} cores, {s['scored_by']['cpu']}" for s in data.get("sets", ())
    ]
    if not cpus and "machine" in data:
        machine = data["machine"]
        cpus = [machine if isinstance(machine, str) else f"{machine.get('cores', '?')} cores, {machine.get('cpu')}"]
    if not cpus:  # several measurements, each with its machine
        parts = [v["machine"] for v in data.values() if isinstance(v, dict) and "machine" in v]
        cpus = [p["gpu"] for p in parts if p.get("gpu")] or [f"{p['cores']} cores" for p in parts if "cores" in p]
    return ", ".join(dict.fromkeys(commits)), ", ".join(dict.fromkeys(cpus)) or "not stored"


def _date(name: str) -> str:
    """Day of the first stored run, or the last change of the file."""
    runs = stored(name).get("runs")
    if isinstance(runs, dict):
        return ", ".join(sorted({key[:10] for key in runs}))
    return ADDED[name][0] if name in ADDED else "not stored"


ADDED = {
    "contact": ("2026-11-22", "a4fab71"),
    "scale_error": ("2026-11-21", "c66a9fe"),
    "diagnosis": ("2026-11-22 to 24", ""),
    "gap_sysid": ("2026-11-22", ""),
    "trainer_speed": ("2026-11-21", "65757eb"),
    "trainer_cpu": ("2026-11-21", "9a16e8c"),
    "trainer_tune": ("2026-11-21", "4995f3d"),
    "training_gpu": ("2026-11-23", "7434329"),
    "base_policy": ("2026-11-24", "638c735"),
    "captures": ("2026-11-24", "c8828f3"),
    "gap_contract": ("2026-11-24", "ee76cd6"),
}
"""Of files that do not say it themselves: the day on which their figures were added, and the commit that added them."""

TABLES: dict[str, Callable[[], list[str]]] = {
    "readme": readme,
    "captures": captures,
    "contact": contact,
    "diagnosis by set": diagnosis_by_set,
    "diagnosis by robot": diagnosis_by_robot,
    "diagnosis by seed": diagnosis_intervals,
    "base policy": base,
    "index": index,
}
MARKED = re.compile(r"(<!-- figures: ([a-z ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


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


if __name__ == "__main__":
    sys.exit(main())
