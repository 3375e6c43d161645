"""The diagnosis on real robots' logs with known errors in their models.

    python benchmarks/diagnosis/real.py make --part report --cases 20  # cases a log; needs the logs (shared/real_logs)
    python benchmarks/diagnosis/real.py run --jobs 16 --minutes 9          # as often as it takes: what is done stays
    python benchmarks/diagnosis/real.py score                              # rows, figures, and the bars

Of each log, every other window fits a baseline: the published model with servo gains, friction, rotor inertia, encoder
zeros and delay of this robot. A known error, two, or none is put into that model; the other windows are diagnosed with
it. So the labels are exact, while noise, clocks and what no model explains are the robot's own. Logs are for
development or for the report, never both. Rows say which engine gave them; no two are scored together.
"""

import argparse
import json
import os
import shutil
import sys
import zlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import pairwise, product
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from benchmarks.diagnosis.hardware.bench import Baseline, Bench, applied, draw, fit, with_error, write
from benchmarks.diagnosis.hardware.errors import errors
from benchmarks.diagnosis.hardware.logs import LOGS
from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.score import MixedEnginesError, hit, one_engine, same, share, short, table
from benchmarks.store import Store
from realsim.core.files import to_json, write_text

Row = dict[str, Any]
SHARES = {"none": 0.2, "single": 0.6, "double": 0.2}
"""Of the cases of a log."""
BASELINES = Path(__file__).parent / "hardware" / "baselines.json"
NAMES = ("identified", "ambiguous", "partly_explained")
"""Verdicts that name a cause; under `unexplained` the nearest one is only listed."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=["make", "run", "score"])
    parser.add_argument("--part", choices=["development", "report"], default="development")
    parser.add_argument("--logs", nargs="*", help="only these logs of the part")
    parser.add_argument("--cases", type=int, default=15, help="cases a log")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this many minutes")
    parser.add_argument("--work", type=Path, default=Path("out/gap_real"))
    parser.add_argument("--shared", type=Path, default=Path(os.environ.get("REALSIM_SHARED", "../shared")))
    parser.add_argument("--store", type=Path, help="rows (default: rows.json in --work)")
    args = parser.parse_args()
    names = [n for n, log in LOGS.items() if log.part == args.part and (not args.logs or n in args.logs)]
    if args.do == "make":
        return make(args, names)
    labels = read_labels(args.work, names)
    if not labels:
        print(f"{args.work} has no cases of {', '.join(names)}: make them first", file=sys.stderr)
        return 2
    if args.do == "run":
        diagnose_all([job(args.work, name) for name in labels], args.jobs, args.minutes)
        return 0
    return store_and_score(args, labels)


# ---------------------------------------------------------------- make


def make(args: argparse.Namespace, names: Sequence[str]) -> int:
    """Baselines where there are none yet, then cases and labels; labels lie in a folder of their own."""
    logs = args.shared / "real_logs"
    if not logs.is_dir():
        print(f"{logs} is missing: --shared says where real_logs lies", file=sys.stderr)
        return 2
    known = json.loads(BASELINES.read_text()) if BASELINES.is_file() else {}
    with ProcessPoolExecutor(args.jobs) as pool:
        jobs = [(n, logs, args.work) for n in names if n not in known]
        for name, baseline in pool.map(_fitted, jobs):
            known[name] = asdict(baseline)
            write_text(BASELINES, to_json(dict(sorted(known.items()))))
            print(f"{name}: baseline leaves {_leaves(known[name])}", flush=True)
        todo = [(n, logs, args.work, known[n], args.seed, i, args.cases) for n in names for i in range(args.cases)]
        for line in pool.map(_made, todo):
            print(line, flush=True)
    return 0


def _leaves(baseline: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{signal} {row['unseen']:.2g} of {row['motion']:.2g} on unseen runs"
        for signal, row in baseline["left"].items()
    )


def _bench(name: str, logs: Path, work: Path) -> Bench:
    folder = work / "logs" / f"{name}_{os.getpid()}"
    shutil.rmtree(folder, ignore_errors=True)
    try:
        return Bench(LOGS[name].make(logs, folder))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _fitted(todo: tuple[str, Path, Path]) -> tuple[str, Baseline]:
    return todo[0], fit(_bench(*todo))


def _made(todo: tuple[str, Path, Path, dict[str, Any], int, int, int]) -> str:
    name, logs, work, known, seed, index, count = todo
    case_name = f"{name}_{index:03d}"
    if (work / "labels" / f"{case_name}.json").is_file():
        return f"{case_name}: made before"
    bench = _bench(name, logs, work)
    case = applied(bench, bench.others, Baseline(**known))
    robot = bench.robot(case)
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
    cls = _class(index, count)
    kinds = sorted({e.kind for e in errors(robot) if e.drawn})
    np.random.default_rng([seed, zlib.crc32(name.encode())]).shuffle(kinds)
    number = {"none": 0, "single": 1, "double": 2}[cls]
    for attempt in range(20):
        chosen = [kinds[(index * max(number, 1) + k + 3 * attempt) % len(kinds)] for k in range(number)]
        drawn = draw(case, robot, chosen, rng)
        if drawn is not None:
            break
    else:
        return f"{case_name}: none of 20 draws is visible"
    shutil.rmtree(work / "cases" / case_name, ignore_errors=True)
    write(with_error(case, drawn.errors), work / "cases" / case_name)
    label = {
        "log": name, "part": LOGS[name].part, "cls": cls, "effects": drawn.labels, "alike": drawn.equivalents,
        "visibility": drawn.visibility, "sizes": [size for _, size in drawn.errors], "seed": seed,
    }  # fmt: skip
    (work / "labels").mkdir(parents=True, exist_ok=True)
    write_text(work / "labels" / f"{case_name}.json", to_json(label))
    return (
        f"{case_name}: {' + '.join(short(e) for e in drawn.labels) or 'none'} visible {np.round(drawn.visibility, 1)}"
    )


def _class(index: int, count: int) -> str:
    """Spread evenly over the indices, in the shares above."""
    place, total = ((index * 7) % count + 0.5) / count, 0.0
    for name, part in SHARES.items():
        total += part
        if place < total:
            return name
    return "double"


# ---------------------------------------------------------------- score


def read_labels(work: Path, names: Iterable[str]) -> dict[str, Row]:
    """Case -> its label, of these logs."""
    found = {f.stem: json.loads(f.read_text()) for f in sorted((work / "labels").glob("*.json"))}
    return {name: label for name, label in found.items() if label["log"] in set(names)}


def job(work: Path, name: str) -> Job:
    return Job(work / "cases" / name, work / "out" / name)


def store_and_score(args: argparse.Namespace, labels: Mapping[str, Row]) -> int:
    answers = {n: a for n in labels if (a := read(job(args.work, n))) is not None}
    try:
        made_by = one_engine(answers)
    except MixedEnginesError as error:
        print(f"{args.work}: {error}; `run` again", file=sys.stderr)
        return 2
    if len(answers) < len(labels):
        print(f"{len(labels) - len(answers)} of {len(labels)} cases have no answer yet: they are left out")
    store = Store(args.store or args.work / "rows.json", ("case", "engine", "settings"))
    rows = [store.add(row(n, labels[n], answers[n])) for n in answers]
    print(f"engine {made_by.get('engine')}, {args.part}, {len(rows)} cases\n{table(figures(rows), BARS)}")
    return 0


def row(name: str, label: Row, answer: Row) -> Row:
    """One case as it is stored."""
    made_by = answer.get("provenance") or {}
    accepted = accepted_sets(label)
    sets = [answer["causes"], *answer["equivalent"]]
    first = answer["causes"][0] if answer["causes"] else None
    return {
        "case": name,
        "engine": made_by.get("engine"),
        "settings": made_by.get("settings"),
        "log": label["log"],
        "part": label["part"],
        "cls": label["cls"],
        "truth": [short(e) for e in label["effects"]],
        "alike": [[short(e) for e in alike] for alike in label["alike"]],
        "visibility": label["visibility"],
        "verdict": answer["verdict"],
        "causes": [short(c) for c in answer["causes"]],
        "equivalent": [[short(c) for c in s] for s in answer["equivalent"]],
        "first_right": first is not None and any(hit(first, t) for s in accepted for t in s),
        "all_right": bool(answer["causes"])
        and all(any(hit(c, t) for s in accepted for t in s) for c in answer["causes"]),
        "set_right": any(same(answer["causes"], s) for s in accepted),
        "set_among_equivalents": any(same(found, s) for found in sets for s in accepted),
        "probability": first.get("probability") if first else None,
        "seconds": answer.get("seconds"),
        "cpu_seconds": answer.get("cpu_seconds"),
        "unexplained_share": answer.get("unexplained_share"),
        "said": answer.get("said") or answer.get("sentence"),
    }


def accepted_sets(label: Row) -> list[list[Row]]:
    """The label, and the label with each cause replaced by one that changes the motion alike."""
    if not label["effects"]:
        return [[]]
    choices = [[e, *alike] for e, alike in zip(label["effects"], label["alike"], strict=True)]
    return [list(s) for s in product(*choices)]


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Shares as [hits, of]; the bars are those of the table below."""
    put_in = [r for r in rows if r["cls"] != "none"]
    nothing = [r for r in rows if r["cls"] == "none"]
    single, double = ([r for r in rows if r["cls"] == c] for c in ("single", "double"))
    named = [r for r in put_in if r["verdict"] in NAMES]
    out: dict[str, Any] = {
        "confident_and_wrong": share(r["verdict"] == "identified" and not r["first_right"] for r in put_in),
        "first_right": share(r["verdict"] in NAMES and r["first_right"] for r in put_in),
        "nothing_put_in_nothing_named": share(
            r["verdict"] == "no_gap" or (not r["causes"] and r["verdict"] != "crashed") for r in nothing
        ),
        "identified_where_nothing_was_put_in": share(r["verdict"] == "identified" for r in nothing),
        "first_right_whatever_the_verdict": share(r["first_right"] for r in put_in),
        "single_first_right": share(r["verdict"] in NAMES and r["first_right"] for r in single),
        "double_both_right": share(r["verdict"] in NAMES and r["set_right"] for r in double),
        "set_right_or_among_equivalents": share(r["set_among_equivalents"] for r in put_in),
        "right_where_a_cause_is_named": share(r["first_right"] for r in named),
        "missed": share(r["verdict"] == "no_gap" for r in put_in),
        "refused_or_crashed": share(r["verdict"] in ("refused", "crashed") for r in rows),
    }
    for key in ("log", "verdict"):
        out[f"first_right_by_{key}"] = {
            v: share(r["first_right"] for r in put_in if r[key] == v) for v in sorted({r[key] for r in put_in})
        }
    kinds = sorted({r["truth"][0].split("@")[0] for r in single})
    out["first_right_by_effect"] = {
        k: share(r["first_right"] for r in single if r["truth"][0].startswith(f"{k}@")) for k in kinds
    }
    out["verdicts"] = {
        c: {v: sum(r["verdict"] == v for r in group) for v in sorted({r["verdict"] for r in group})}
        for c, group in (("none", nothing), ("single", single), ("double", double))
    }
    out["reliability"] = reliability(rows)
    times = [r["cpu_seconds"] for r in rows if r.get("cpu_seconds")]
    out["cpu_seconds_median_and_most"] = [round(float(np.median(times)), 1), round(max(times), 1)] if times else None
    return out


def reliability(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Bin of stated probability -> [mean stated, share right, how many]; empty where none is stated."""
    stated = [(r["probability"], r["first_right"]) for r in rows if r.get("probability") is not None]
    edges = [0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0 + 1e-9]
    found: dict[str, list[Any]] = {}
    for low, high in pairwise(edges):
        inside = [(p, right) for p, right in stated if low <= p < high]
        if inside:
            mean, right = np.mean(np.array(inside, float), axis=0)
            found[f"{low:.1f} to {min(high, 1.0):.1f}"] = [round(float(mean), 2), round(float(right), 2), len(inside)]
    return found


BARS = {
    "confident_and_wrong": "<= 0.083",
    "first_right": ">= 0.75",
    "nothing_put_in_nothing_named": ">= 0.80",
}


if __name__ == "__main__":
    raise SystemExit(main())
