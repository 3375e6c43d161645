"""The withheld check of `realsim diagnose`: logs whose cause is known only here.

    python benchmarks/diagnosis/withheld.py --cases 200 --seed 7 --jobs 2

Makes cases with `tests.truths.diagnosis` (which shares no code with the diagnosis), keeps the labels apart, runs the
diagnosis over the cases in processes of its own, and scores what it wrote. Prints a table and stores the figures.
Cases that are already diagnosed in --work are kept, so an interrupted run goes on where it stopped. A seed makes the
same cases everywhere; results/diagnosis.json holds the cases of every seed that was scored. Diagnoses of several
engines are not scored together: each says which engine gave it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.score import (
    BARS,
    MixedEnginesError,
    exactly_right,
    intervals_hold,
    look_alikes_named,
    one_engine,
    score,
    table,
)
from benchmarks.store import described_run
from realsim.core.files import to_json, write_text
from realsim.gap.config import DiagnoseConfig
from realsim.gap.provenance import provenance
from tests.truths.diagnosis.cases import make_labelled, plan, read_labels

STORED = Path(__file__).parents[1] / "results" / "diagnosis.json"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--robots", nargs="*", help="only these robots")
    parser.add_argument("--work", type=Path, default=Path("out/gap_withheld"))
    parser.add_argument("--store", type=Path, help="file for the figures (default: figures.json in --work)")
    parser.add_argument("--note", default="", help="what else to know of the figures; kept with them")
    parser.add_argument("--keep", metavar="COMMIT", help="add the cases to results/diagnosis.json, as of this engine")
    parser.add_argument("--score", action="store_true", help="only score what --work holds already")
    parser.add_argument(
        "--developed-on", nargs="*", default=[], help="cases whose failures were looked at: also without"
    )
    args = parser.parse_args()
    labels = read_labels(args.work) if args.score else make_all(args)
    seconds = 0.0 if args.score else diagnose_all(args, sorted(labels))
    found = read_found(args.work, sorted(labels))
    try:
        one_engine(found)
    except MixedEnginesError as error:
        print(f"{args.work}: {error}. Diagnose them anew: remove {args.work / 'out'}.", file=sys.stderr)
        return 2
    if args.score:
        labels = {n: labels[n] for n in found}
    made = {"seconds": seconds, "cases": len(labels), "seed": args.seed, "note": args.note, "run": described_run()}
    figures = score(labels, found) | made
    print("\n".join(case_line(name, kept_row(labels[name], found[name])) for name in sorted(found)), end="\n\n")
    print(table(figures))
    if args.developed_on:
        fresh = [n for n in found if n not in args.developed_on]
        other = score({n: labels[n] for n in fresh}, {n: found[n] for n in fresh})
        print(f"\nThe {len(fresh)} cases that development did not look at:\n{table(other)}")
        figures |= {"developed_on": args.developed_on, "not_developed_on": {k: other[k] for k in other if k in BARS}}
    store = args.store or args.work / "figures.json"
    store.parent.mkdir(parents=True, exist_ok=True)
    store.write_text(json.dumps(figures, indent=1) + "\n")
    if args.keep:
        keep(args.keep, args.seed, labels, found, figures)
    return 0


def make_all(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Write the cases below work/cases and the labels to work/labels, a folder that the diagnosis is never told of."""
    todo = [(i, d) for i, d in enumerate(plan(args.cases, args.seed)) if not args.robots or d.robot in args.robots]
    with ProcessPoolExecutor(args.jobs) as pool:
        numbers, draws = zip(*todo, strict=True) if todo else ((), ())
        for line in pool.map(make_labelled, numbers, draws, [args.work] * len(todo)):
            print(line, file=sys.stderr, flush=True)
    names = {f"case_{i:03d}" for i, _ in todo}
    return {n: label for n, label in read_labels(args.work).items() if n in names}


KEPT = (
    "note", "ci90_holds_truth", "gap_gone_median_where_right", "baselines", "outside_said", "confounded_named",
    "single_top1_with_equivalents", "double_both_found_with_equivalents",
)  # fmt: skip
"""Figures of a set that its rows do not give."""


def keep(
    commit: str, seed: int, labels: dict[str, Any], found: dict[str, Any], figures: dict[str, Any], path: Path = STORED
) -> None:
    """Add the diagnosed cases of a seed to the stored ones, in place of those that this engine gave before."""
    data = json.loads(path.read_text())
    run = figures["run"]
    scored_by = {k: run[k] for k in ("commit", "cpu", "cores")}
    made = {"seed": seed, "commit": commit, "cases": len(found), "scored_by": scored_by}
    engine = (seed, commit)
    rows = [r for r in data.pop("rows") if (r["seed"], r["commit"]) != engine or r["case"] not in found]
    stay = [s for s in data["sets"] if (s["seed"], s.get("commit")) != engine]
    data["sets"] = [*stay, made | {k: figures[k] for k in KEPT}]
    rows += [kept_row(labels[n], found[n]) | {"seed": seed, "case": n, "commit": commit} for n in sorted(found)]
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    data["days"] = [*dict.fromkeys([*data["days"], day])]
    sets, head = data.pop("sets"), json.dumps(data).removesuffix("}")
    write_text(path, f'{head}, "sets": [\n{_lines(sets)}\n],\n"rows": [\n{_lines(rows)}\n]}}\n')


def _lines(items: list[dict[str, Any]]) -> str:
    """An item a line."""
    return ",\n".join(json.dumps(json.loads(to_json(item)), ensure_ascii=False) for item in items)


def case_line(name: str, row: dict[str, Any]) -> str:
    """One case for people: what was put in, the answer, and what it is worth."""
    put_in, named = (", ".join(row[k]) or "nothing" for k in ("truth", "causes"))
    if not row["truth"]:
        worth = "right" if row["verdict"] == "no_gap" else "false alarm"
    elif exactly_right(row["verdict"], row["causes"], row["truth"]):
        worth = "exactly right"
    elif row["truth"][0] in row["causes"][:1]:
        worth = "named first"
    else:
        worth = "among the equivalents" if row["truth"] in row["equivalent"] else "not named"
    return f"{name}  {row['robot']:<9}  {row['cls']:<10}  put in: {put_in}  |  {row['verdict']}: {named}  |  {worth}"


def kept_row(label: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """A case as it is stored: causes as effect@places."""

    def short(cause: dict[str, Any]) -> str:
        return f"{cause['effect']}@{'+'.join(cause.get('joints') or cause.get('bodies') or [])}"

    return {
        "cls": label["cls"],
        "robot": label["robot"],
        "truth": [short(e) for e in label["effects"]],
        "verdict": found["verdict"],
        "causes": [short(c) for c in found["causes"]],
        "equivalent": [[short(c) for c in group] for group in found["equivalent"]],
        "unexplained_share": found.get("unexplained_share"),
        "visibility": [round(float(v), 1) for v in label["visibility"]],
        "held": intervals_hold(label, found),
        "look_alikes_named": look_alikes_named(label, found) if label["cls"] == "confounded" else None,
        "seconds": (found.get("statistics") or {}).get("seconds"),
        "cpu_seconds": found.get("cpu_seconds"),
    }


def read_found(work: Path, names: list[str]) -> dict[str, dict[str, Any]]:
    """Case -> its diagnosis; a case that the tool refused counts as one without an answer."""
    found: dict[str, dict[str, Any]] = {}
    for name in names:
        if (file := work / "out" / name / "diagnosis.json").is_file():
            found[name] = json.loads(file.read_text())
        elif refused := next((f for f in _refusals(work, name) if f.is_file()), None):
            refusal = json.loads(refused.read_text())
            made = {"provenance": refusal.get("provenance")}
            found[name] = {"verdict": "refused", "causes": [], "equivalent": [], **made}
    return found


def _refusals(work: Path, name: str) -> tuple[Path, Path]:
    """Where a refusal may lie: `realsim diagnose` says it, `pool` writes it beside the answers."""
    return work / "refused" / f"{name}.json", work / "out" / name / "refused.json"


def diagnose_all(args: argparse.Namespace, names: list[str]) -> float:
    """Run `realsim diagnose`, in processes of its own, over all cases that have no diagnosis yet; wall seconds."""
    out = (args.work / "out").absolute()
    todo = [n for n in names if not (out / n / "diagnosis.json").is_file()]
    began = time.perf_counter()
    if todo:
        folders = [str(args.work / "cases" / n) for n in todo]
        # Of a single case the diagnosis lies in --out itself, of several in a folder each.
        target = out / todo[0] if len(todo) == 1 else out
        options = ["--out", str(target), "--jobs", str(args.jobs), "--threads", "1", "--no-report", "--json"]
        command = [sys.executable, "-m", "realsim", "diagnose", *folders, *options]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode not in (0, 1):
            print(done.stderr[-2000:], file=sys.stderr)
        _note_refusals(args.work / "refused", todo, done.stdout)
    return time.perf_counter() - began


def _note_refusals(folder: Path, todo: list[str], said: str) -> None:
    """Keep the reason of every case that ended with bad input (exit code 2)."""
    try:
        answer = json.loads(said)
    except json.JSONDecodeError:
        return
    items = answer.get("items", [{"name": todo[0], "exit_code": 2, **answer}] if "error" in answer else [])
    for item in items:
        if item.get("exit_code") == 2:
            folder.mkdir(parents=True, exist_ok=True)
            item["provenance"] = provenance(DiagnoseConfig())
            (folder / f"{item['name']}.json").write_text(json.dumps(item, indent=1) + "\n")


if __name__ == "__main__":
    raise SystemExit(main())
