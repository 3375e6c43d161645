"""Answers for logs whose labels are withheld (shared/gap_blind): all of them by one engine, in one go.

    python benchmarks/diagnosis/blind.py run --jobs 2       # again after an interruption: what is answered stays
    python benchmarks/diagnosis/blind.py store              # results/gap_blind.json, and a table

The cases cannot be scored here. They were never developed on: run them when the engine is settled, and store what comes
out. Answers of several engines are refused.
"""

import argparse
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import mujoco
import numpy as np

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import MixedEnginesError, one_engine
from benchmarks.store import Store

STORE = Path(__file__).parents[1] / "results" / "gap_blind.json"
ROBOTS = {1: "pendulum", 2: "arm2", 6: "arm6", 12: "quadruped"}
"""Actuators -> robot; more is the humanoid."""
DIGITS = 6

Row = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=["run", "store"])
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this many minutes")
    parser.add_argument("--work", type=Path, default=Path("out/gap_blind"))
    parser.add_argument("--shared", type=Path, default=Path(os.environ.get("REALSIM_SHARED", "../shared")))
    parser.add_argument("--commit", help="of the engine, where the answers were made by an earlier one than this")
    args = parser.parse_args()
    cases = sorted(p for p in (args.shared / "gap_blind").glob("case_*") if p.is_dir())
    if not cases:
        print(f"{args.shared / 'gap_blind'} has no cases: --shared says where gap_blind lies", file=sys.stderr)
        return 2
    jobs = [Job(case, args.work / case.name) for case in cases]
    if args.do == "run":
        diagnose_all(jobs, args.jobs, args.minutes)
        return 0
    return store(jobs, args.commit)


def store(jobs: list[Job], commit: str | None) -> int:
    """Write the answers that are there; say how many are not."""
    answers = {job.case.name: found for job in jobs if (found := read(job)) is not None}
    try:
        made_by = one_engine(answers)
    except MixedEnginesError as error:
        print(f"{error}; `run` again", file=sys.stderr)
        return 2
    STORE.unlink(missing_ok=True)
    rows = Store(STORE, ("case",))
    commit = commit or rows.runs[rows.run]["commit"]
    rows.facts = {
        "note": "Answers for logs whose labels are not in this repository: they cannot be scored here. Of one engine.",
        "engine": made_by.get("engine"),
        "settings": made_by.get("settings"),
        "not_answered": [job.case.name for job in jobs if job.case.name not in answers],
    }
    for job in jobs:
        if job.case.name in answers:
            rows.add(compact(job.case, answers[job.case.name]) | {"commit": commit})
    print(table(rows.rows))
    print("not answered:", ", ".join(rows.facts["not_answered"]) or "none")
    return 0


def compact(case: Path, answer: Row) -> Row:
    """What a reader needs of a diagnosis."""
    checked = answer.get("shrinkage") or {}
    return {
        "case": case.name,
        "robot": robot(case),
        "verdict": answer["verdict"],
        "causes": [_cause(c) for c in answer["causes"]],
        "equivalent": [[_cause(c) for c in one] for one in answer["equivalent"]],
        "removed_on_unseen": {k: _short(checked.get(k)) for k in ("fraction", "ci90", "runs", "unseen")},
        "unexplained_share": _short(answer.get("unexplained_share")),
        "cpu_seconds": round(answer.get("cpu_seconds") or 0.0, 2),
    }


def robot(case: Path) -> str:
    """Name of the robot of a case."""
    return ROBOTS.get(mujoco.MjModel.from_xml_path(str(case / "model.xml")).nu, "g1")


def _cause(cause: Row) -> Row:
    places = {k: cause[k] for k in ("joints", "bodies", "start", "duration") if cause.get(k)}
    values = {name: {k: _short(v) for k, v in p.items()} for name, p in cause["parameters"].items()}
    return {"effect": cause["effect"], **places, "parameters": values}


def _short(value: Any) -> Any:
    """Numbers with DIGITS digits."""
    if isinstance(value, list):
        return [_short(v) for v in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def table(rows: list[Row]) -> str:
    """Verdicts and times by robot."""
    lines = ["| robot | cases | verdicts | CPU seconds, median and slowest |", "|---|---|---|---|"]
    for name in dict.fromkeys(r["robot"] for r in rows):
        mine = [r for r in rows if r["robot"] == name]
        verdicts = ", ".join(f"{n} {v}" for v, n in sorted(Counter(r["verdict"] for r in mine).items()))
        seconds = [r["cpu_seconds"] for r in mine]
        lines.append(f"| {name} | {len(mine)} | {verdicts} | {np.median(seconds):.0f}, {max(seconds):.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
