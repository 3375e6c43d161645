"""The withheld check of `realsim diagnose`: logs whose cause is known only here.

    python benchmarks/gap_withheld.py --cases 200 --jobs 2

Makes cases with `benchmarks.gap_truth` (which shares no code with the diagnosis), keeps the labels apart, runs the
diagnosis over the cases in processes of its own, and scores what it wrote. Prints a table and stores the figures.
Cases that are already diagnosed in --work are kept, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.gap_score import score, table
from benchmarks.gap_truth.cases import Draw, make_case, plan

RESULTS = Path(__file__).parent / "results" / "gap_withheld.json"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--robots", nargs="*", help="only these robots")
    parser.add_argument("--work", type=Path, default=Path("out/gap_withheld"))
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    labels = make_all(args)
    seconds = diagnose_all(args, sorted(labels))
    found = {
        n: json.loads(f.read_text())
        for n in sorted(labels)
        if (f := args.work / "out" / n / "diagnosis.json").is_file()
    }
    figures = score(labels, found) | {"machine": machine(), "seconds": seconds, "cases": len(labels), "seed": args.seed}
    print(table(figures))
    args.store.parent.mkdir(parents=True, exist_ok=True)
    args.store.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


def make_all(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Write the cases below work/cases and the labels to work/labels, a folder that the diagnosis is never told of."""
    todo = [(i, d) for i, d in enumerate(plan(args.cases, args.seed)) if not args.robots or d.robot in args.robots]
    labels_folder = args.work / "labels"
    labels_folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(args.jobs) as pool:
        list(pool.map(_make, [(i, draw, str(args.work)) for i, draw in todo]))
    names = {f"case_{i:03d}" for i, _ in todo}
    return {
        n: json.loads((labels_folder / f"{n}.json").read_text())
        for n in sorted(names)
        if (labels_folder / f"{n}.json").is_file()
    }


def _make(job: tuple[int, Draw, str]) -> None:
    index, draw, work = job
    name = f"case_{index:03d}"
    label_file = Path(work) / "labels" / f"{name}.json"
    if label_file.is_file():
        return
    try:
        label = make_case(draw, Path(work) / "cases" / name)
    except RuntimeError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return
    label_file.write_text(json.dumps(label, indent=1, default=float) + "\n")


def diagnose_all(args: argparse.Namespace, names: list[str]) -> float:
    """Run `realsim diagnose` over all cases that have no diagnosis yet; wall seconds."""
    out = (args.work / "out").absolute()
    todo = [str(args.work / "cases" / n) for n in names if not (out / n / "diagnosis.json").is_file()]
    began = time.perf_counter()
    # In portions, so that what is finished stays finished if this is stopped.
    for k in range(0, len(todo), 4 * args.jobs):
        part = todo[k : k + 4 * args.jobs]
        command = [
            sys.executable,
            "-m",
            "realsim",
            "diagnose",
            *part,
            "--out",
            str(out),
            "--jobs",
            str(args.jobs),
            "--json",
        ]
        if len(part) == 1:
            command[command.index("--out") + 1] = str(out / Path(part[0]).name)
        done = subprocess.run(command, capture_output=True, text=True)
        print(
            f"{min(k + len(part), len(todo))}/{len(todo)} diagnosed, {time.perf_counter() - began:.0f} s",
            file=sys.stderr,
        )
        if done.returncode not in (0, 1):
            print(done.stdout[-500:], done.stderr[-2000:], file=sys.stderr)
    return time.perf_counter() - began


def machine() -> str:
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


if __name__ == "__main__":
    raise SystemExit(main())
