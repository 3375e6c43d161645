"""The withheld check of `realsim diagnose`: logs whose cause is known only here.

    python benchmarks/diagnosis/withheld.py --cases 200 --seed 7 --jobs 2

Makes cases with `tests.truths.diagnosis` (which shares no code with the diagnosis), keeps the labels apart, runs the
diagnosis over the cases in processes of its own, and scores what it wrote. Prints a table and stores the figures.
Cases that this engine has diagnosed in --work are kept: an interrupted run goes on where it stopped. A seed makes the
same cases everywhere; results/diagnosis.json holds the cases of every seed that was scored. Diagnoses of several
engines are not scored together: each says which engine gave it.
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import (
    BARS,
    MixedEnginesError,
    exactly_right,
    intervals_hold,
    look_alikes_named,
    one_engine,
    score,
    short,
    table,
)
from benchmarks.store import described_run
from realsim.core.files import to_json, write_text
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
    labels, began = read_labels(args.work) if args.score else make_all(args), time.perf_counter()
    jobs = {n: Job(args.work / "cases" / n, args.work / "out" / n) for n in sorted(labels)}
    if not args.score:
        diagnose_all(list(jobs.values()), args.jobs)
    found = {n: answer for n, job in jobs.items() if (answer := read(job)) is not None}
    seconds = 0.0 if args.score else time.perf_counter() - began
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
    "note", "ci90_holds_truth", "gap_gone_median_where_right", "outside_said", "confounded_named",
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


if __name__ == "__main__":
    raise SystemExit(main())
