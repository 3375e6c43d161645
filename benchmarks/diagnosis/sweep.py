"""How the diagnosis bears larger everyday deviations and louder sensors than its priors expect.

    python benchmarks/diagnosis/sweep.py make --cases 40 --seed 11 --jobs 16
    python benchmarks/diagnosis/sweep.py run --jobs 16 --minutes 9      # as often as it takes: what is done stays
    python benchmarks/diagnosis/sweep.py score

The same cases (same robots, causes, commands) with the generator's everyday deviations x0.5, 1, 2, 4 and its noise x1
and 3. Only one of the two is changed at a time. All levels are of one engine, or nothing is printed.
"""

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import MixedEnginesError, one_engine, score
from benchmarks.store import Store
from tests.truths.diagnosis.cases import STRATA, Draw, make_labelled, plan, read_labels

LEVELS = {"deviations_0.5": (0.5, 1.0), "as_drawn": (1.0, 1.0), "deviations_2": (2.0, 1.0), "deviations_4": (4.0, 1.0),
          "noise_3": (1.0, 3.0)}  # fmt: skip
"""Name -> (ratio on the everyday deviations, ratio on the noise)."""
COLUMNS = (
    "false_alarms", "single_top1", "single_top1_with_equivalents", "double_both_found", "outside_said",
    "confounded_named", "ci90_holds_truth", "missed_gaps",
)  # fmt: skip


SHOWN = (*COLUMNS, "identified_right")
KEY = ("seed", "engine", "level")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=["make", "run", "score"])
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="*", help="only these robots")
    parser.add_argument("--strata", nargs="*", choices=list(STRATA), default=list(STRATA), help="only such cases")
    parser.add_argument("--levels", nargs="*", choices=list(LEVELS), default=list(LEVELS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this many minutes")
    parser.add_argument("--work", type=Path, default=Path("out/gap_sweep"))
    parser.add_argument("--store", type=Path, help="file for the figures (default: figures.json in --work)")
    args = parser.parse_args()
    if args.do == "make":
        draws = [(i, d) for i, d in enumerate(plan(args.cases, args.seed)) if d.stratum in args.strata]
        draws = [(i, d) for i, d in draws if not args.robots or d.robot in args.robots]
        todo = [(i, d, level, args.work) for i, d in draws for level in args.levels]
        with ProcessPoolExecutor(args.jobs) as pool:
            for line in pool.map(_make, todo):
                print(line, flush=True)
        return 0
    labels = {level: read_labels(args.work / level) for level in args.levels}
    if args.do == "run":
        # Case by case over all levels: what is done after some time is a fair sample of each.
        order = sorted((name, level) for level in args.levels for name in labels[level])
        diagnose_all([_job(args.work / level, name) for name, level in order], args.jobs, args.minutes)
        return 0
    return _score(args, labels)


def _make(todo: tuple[int, Draw, str, Path]) -> str:
    index, draw, level, work = todo
    deviations, noise = LEVELS[level]
    return f"{level}/{make_labelled(index, draw, work / level, deviations, noise)}"


def _job(folder: Path, name: str) -> Job:
    return Job(folder / "cases" / name, folder / "out" / name)


def _score(args: argparse.Namespace, labels: dict[str, dict[str, Any]]) -> int:
    answers = {v: {n: a for n in labels[v] if (a := read(_job(args.work / v, n))) is not None} for v in args.levels}
    shared = set.intersection(*(set(found) for found in answers.values())) if answers else set()
    answers = {v: {n: found[n] for n in sorted(shared)} for v, found in answers.items()}
    try:
        made_by = one_engine({f"{v}/{n}": a for v, found in answers.items() for n, a in found.items()})
    except MixedEnginesError as error:
        print(f"{args.work}: {error}; `run` again", file=sys.stderr)
        return 2
    if not shared:
        print("no case is answered at all levels yet", file=sys.stderr)
        return 2
    figures = {v: score({n: labels[v][n] for n in found}, found) for v, found in answers.items()}
    for level, found in figures.items():
        right = found["causes_right_by_verdict"].get("identified", [0, 0])
        figures[level]["identified_right"] = right
    print(f"engine {made_by.get('engine')}: {len(shared)} cases at every level")
    for column in SHOWN:
        cells = [f"{v} {_text(found[column])}" for v, found in figures.items()]
        print(f"{column:<30} {'   '.join(cells)}")
    store = Store(args.store or args.work / "figures.json", KEY)
    robots = sorted({labels[level][n]["robot"] for level, found in answers.items() for n in found})
    for level, found in figures.items():
        row = {
            "seed": args.seed,
            "engine": made_by.get("engine"),
            "level": level,
            "cases": len(shared),
            "robots": robots,
        } | ({} if len(args.strata) == len(STRATA) else {"strata": args.strata})
        store.add(row | {column: found[column] for column in SHOWN})
    return 0


def _text(share: list[int]) -> str:
    return f"{share[0]}/{share[1]}"


if __name__ == "__main__":
    raise SystemExit(main())
