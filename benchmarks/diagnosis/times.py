"""How long a diagnosis takes on a machine that does nothing else: case after case, each on all cores.

python benchmarks/diagnosis/sweep.py make --cases 40 --seed 11 --levels as_drawn
python benchmarks/diagnosis/times.py --seed 11            # what is done stays, so that an interrupted run goes on
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store
from realsim.core.files import to_json, write_text
from realsim.gap import DiagnoseConfig, diagnose, load_case
from realsim.gap.provenance import engine
from tests.truths.diagnosis.cases import read_labels

KEY = ("seed", "engine", "case")
RESULTS = Path(__file__).parents[1] / "results" / "gap_times.json"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the cases")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, default=Path("out/gap_sweep"), help="where sweep.py made them")
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    folder = args.work / "as_drawn"
    store = Store(args.store, KEY)
    for name, label in sorted(read_labels(folder).items()):
        answer = _answer(folder / "cases" / name, folder / f"on_{args.threads}" / f"{name}.json", args.threads)
        row = {"seed": args.seed, "engine": engine(), "case": name, "robot": label["robot"], "threads": args.threads}
        took = {what: round(answer[what], 1) for what in ("seconds", "cpu_seconds")}
        print(store.add(row | took | {"verdict": answer["verdict"]}), flush=True)
    return 0


def _answer(case: Path, out: Path, threads: int) -> dict[str, Any]:
    """That of this engine which lies there, or a new one, in a process of its own."""
    if out.is_file():
        found = dict(json.loads(out.read_text()))
        if found["provenance"]["engine"] == engine():
            return found
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        write_text(out, pool.submit(_diagnose, case, threads).result())
    return dict(json.loads(out.read_text()))


def _diagnose(case: Path, threads: int) -> str:
    return to_json(diagnose(load_case(case), DiagnoseConfig(threads=threads, report=False)).as_dict())


if __name__ == "__main__":
    raise SystemExit(main())
