"""The experimental selection beside the stored answers of the released engine, case by case.

    python benchmarks/gap_engine.py --seed 101 --robots pendulum arm2 --jobs 2 --work out/gap_engine

Makes the cases of a seed with `benchmarks.gap_truth`, diagnoses each in a process of its own, and writes one row a case
to WORK/rows. `--score` prints the table: paired with `cases_detail` of `--against` where that holds the same case.
Rows that are there are kept, so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.gap_score import _confounded, _parameters, hit, top1
from benchmarks.gap_truth.cases import Draw, make_case, plan
from benchmarks.store import described_run

Row = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--cases", type=int, default=100, help="how many the seed is drawn for")
    parser.add_argument("--robots", nargs="*", default=["pendulum", "arm2"])
    parser.add_argument("--only", type=int, nargs="*", help="only these numbers")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, default=Path("out/gap_engine"))
    parser.add_argument("--until", type=float, default=1e9, help="seconds after which no further case is begun")
    parser.add_argument("--against", type=Path, nargs="*", default=[], help="stored figures with cases_detail")
    parser.add_argument("--score", action="store_true", help="only print the table of the rows that are there")
    args = parser.parse_args()
    if not args.score:
        began = time.time()
        draws = [(i, d) for i, d in enumerate(plan(args.cases, args.seed)) if d.robot in args.robots]
        draws = [(i, d) for i, d in draws if not args.only or i in args.only]
        for name in ("rows", "labels"):
            (args.work / name).mkdir(parents=True, exist_ok=True)
        run = described_run()
        with ProcessPoolExecutor(args.jobs, max_tasks_per_child=1) as pool:
            jobs = [(args.seed, i, d, str(args.work), began + args.until, run) for i, d in draws]
            for said in pool.map(_work, jobs):
                print(said, flush=True)
    print(table(args.work, args.against))
    return 0


def _work(job: tuple[int, int, Draw, str, float, Row]) -> str:
    seed, index, draw, work, until, run = job
    name = f"{seed}_{index:03d}"
    row_file, label_file = Path(work) / "rows" / f"{name}.json", Path(work) / "labels" / f"{name}.json"
    case = Path(work) / "cases" / name
    if row_file.is_file():
        return f"{name}: kept"
    if time.time() > until:
        return f"{name}: not begun"
    try:
        if not label_file.is_file():
            label_file.write_text(json.dumps(make_case(draw, case), indent=1, default=float) + "\n")
    except RuntimeError as error:
        return f"{name}: {error}"
    from realsim.gap.config import DiagnoseConfig
    from realsim.gap.logs.case import load_case
    from realsim.gap.selection.engine import answer

    try:
        found = answer(load_case(case), DiagnoseConfig(threads=1))
    except Exception:
        found = {
            "verdict": "failed",
            "causes": [],
            "equivalent": [],
            "cpu_seconds": 0.0,
            "reason": traceback.format_exc(),
        }
    row = {"name": name, "seed": seed, "case": index, "commit": run["commit"], **found}
    row_file.write_text(json.dumps(row, indent=1, default=float) + "\n")
    return line(json.loads(label_file.read_text()), row)


def line(label: Row, row: Row) -> str:
    """One case in a line."""
    first, truth = "; ".join(_places(row["causes"])), "; ".join(_places(label["effects"]))
    check = row.get("check") or {}
    return (
        f"{row['name']} {label['robot']:10s} {label['cls']:10s} {truth:40s} -> {row['verdict']:16s} {first} "
        f"(+{len(row['equivalent'])}) stays {check.get('stays_over_floor', float('nan')):.1f} "
        f"removed {check.get('removed', float('nan')):.2f} cpu {row['cpu_seconds']:.0f}"
    )


def table(work: Path, against: list[Path]) -> str:
    """Hits of both engines on the same cases, by question."""
    rows = {f.stem: json.loads(f.read_text()) for f in sorted((work / "rows").glob("*.json"))}
    labels = {n: json.loads((work / "labels" / f"{n}.json").read_text()) for n in rows}
    old: dict[str, Row] = {}
    for file in against:
        stored = json.loads(file.read_text())
        old |= {f"{stored['seed']}_{n.removeprefix('case_')}": d for n, d in stored["cases_detail"].items()}
    counts: dict[str, list[int]] = {}

    def count(question: str, new: bool, before: bool | None) -> None:
        cell = counts.setdefault(question, [0, 0, 0, 0, 0, 0])
        cell[0] += new
        cell[1] += 1
        if before is not None:
            cell[2] += new
            cell[3] += before
            cell[4] += 1
            cell[5] += 1 if new and not before else 0

    lines: list[str] = []
    paired: set[str] = set()
    for name, row in rows.items():
        label, was = labels[name], old.get(name)
        if was and was["truth"] != _places(label["effects"]):
            was = None  # drawn for another number of cases: not the same case
        paired |= {name} if was else set()
        said = was and _detail_as_answer(was)
        cls = label["cls"]
        lines.append(line(label, row) + (f"   was: {was['verdict']} {' '.join(was['causes'])}" if was else ""))
        if cls == "single":
            count("one cause first", top1(label, row) == 2, top1(label, said) == 2 if said else None)
            count("with equivalents", top1(label, row) >= 1, top1(label, said) >= 1 if said else None)
        elif cls == "double":
            count("both of two", _both(label, row), _both(label, said) if said else None)
        elif cls == "none":
            count("no false alarm", row["verdict"] == "no_gap", said["verdict"] == "no_gap" if said else None)
        elif cls == "outside":
            count("outside: unexplained", row["verdict"] == "unexplained", _open(said) if said else None)
            count("outside: unexplained or partly", _open(row), _open(said) if said else None)
        elif cls == "confounded":
            count("look-alikes said", _confounded(label, row), _confounded(label, said) if said else None)
        if cls in ("single", "double") and row["verdict"] == "identified":
            right = all(any(hit(c, t) for t in label["effects"]) for c in row["causes"])
            count("identified is right", right, None)
    known = [n for n in rows if labels[n]["cls"] in ("single", "double")]
    _, held = _parameters(labels, rows, known)
    lines.append("")
    lines.append(f"{'question':32s} {'new':>9s}   on stored cases: new, old, of (new alone right)")
    for question, (hits, of, new, before, shared, alone) in counts.items():
        lines.append(f"{question:32s} {hits:4d}/{of:<4d}   {new:4d} {before:4d} {shared:4d} ({alone})")
    lines.append(f"{'90 % intervals hold':32s} {sum(held):4d}/{len(held):<4d}")
    for robot in sorted({labels[n]["robot"] for n in rows}):
        names = [n for n in rows if labels[n]["robot"] == robot]
        cpu = sorted(rows[n]["cpu_seconds"] for n in names)
        before = sorted(old[n]["cpu_seconds"] for n in names if n in paired)
        middle = f"{before[len(before) // 2]:.0f}" if before else "-"
        lines.append(f"CPU seconds, {robot:10s} median {cpu[len(cpu) // 2]:.0f} (was {middle}), longest {cpu[-1]:.0f}")
    return "\n".join(lines)


def _places(causes: list[Row]) -> list[str]:
    return [f"{c['effect']}@{','.join(c.get('joints') or c.get('bodies') or [])}" for c in causes]


def _both(label: Row, answer: Row) -> bool:
    return all(any(hit(c, t) for c in answer["causes"]) for t in label["effects"])


def _open(answer: Row) -> bool:
    return answer["verdict"] in ("unexplained", "partly_explained")


def _detail_as_answer(detail: Row) -> Row:
    """A stored line of the released engine in the form of an answer."""

    def cause(text: str) -> Row:
        effect, _, place = text.partition("@")
        names = [p for p in place.split(",") if p]
        return {"effect": effect, "joints": names, "bodies": names, "parameters": {}}

    return {
        "verdict": detail["verdict"],
        "causes": [cause(c) for c in detail["causes"]],
        "equivalent": [[cause(c) for c in s] for s in detail["equivalent"]],
    }


if __name__ == "__main__":
    raise SystemExit(main())
