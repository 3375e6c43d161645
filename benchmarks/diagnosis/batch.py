"""All benchmarks of the diagnosis that need no made cases from elsewhere, in one pool, the most wanted first.

    python benchmarks/diagnosis/batch.py --jobs 14 --minutes 9 --out out/batch     # goes on where it was broken off
    python benchmarks/diagnosis/batch.py --score --out out/batch      # into benchmarks/results, as REALSIM_COMMIT's

The policies' contracts (contract.py), errors put into models of real robots (put_in.py), damaged drones (flights.py), a
fresh made seed, real report logs (real.py): the answers lie in a folder each below --out. The fresh seed and the real
logs are scored by `withheld.py --score --work OUT/fresh/as_drawn` and `real.py score --work OUT/real --part report`.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis import flights, put_in, real
from benchmarks.diagnosis.hardware.logs import LOGS
from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.store import Store
from realsim.gap.provenance import engine
from tests.truths.diagnosis.cases import make_labelled, plan, read_labels

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"
PARTS = ("contract", "put_in", "flights", "fresh", "real")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shared", type=Path, default=Path(os.environ.get("REALSIM_SHARED", "../shared")))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="of all together")
    parser.add_argument(
        "--seconds", type=int, default=300, help="time limit of a case; at 1.5 times the CPU time it crashed"
    )
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seed", type=int, default=3001, help="of the fresh cases")
    parser.add_argument("--cases", type=int, default=60, help="fresh ones")
    parser.add_argument("--out", type=Path, default=Path("out/batch"))
    parser.add_argument("--score", action="store_true", help="store what was answered, and run nothing")
    args = parser.parse_args()
    if args.score:
        return score(args)
    began, work = time.monotonic(), args.out
    if "contract" in args.parts:
        command = [str(HERE / "contract.py"), "--jobs", str(args.jobs), "--out", str(work / "contract.json")]
        subprocess.run([sys.executable, *command], check=False)

    def answer(jobs: Iterable[Job]) -> None:
        minutes = args.minutes - (time.monotonic() - began) / 60
        settings, seconds = {"time_limit": args.seconds / 60}, round(1.5 * args.seconds)
        diagnose_all(
            [replace(job, seconds=seconds, settings=job.settings | settings) for job in jobs], args.jobs, minutes
        )

    jobs = []
    if "put_in" in args.parts:
        jobs += [Job(f, work / "put_in" / engine() / n) for n, (f, _) in put_in.labelled(args.shared).items()]
    if "flights" in args.parts:
        jobs += [job for both in flights.jobs(args.shared, work / "flights").values() for job in both]
    answer(jobs)  # before cases are made, which takes minutes
    if "real" in args.parts:
        options = argparse.Namespace(work=work / "real", shared=args.shared, jobs=args.jobs, seed=1, cases=20)
        names = [n for n, log in LOGS.items() if log.part == "report"]
        real.make(options, names)
        answer(real.job(options.work, n) for n in real.read_labels(options.work, names))
    if "fresh" in args.parts:
        drawn = fresh(args, work / "fresh" / "as_drawn")
        answer(job for job, _ in sorted(drawn, key=lambda of: of[1]))  # the longest last
    return 0


def score(args: argparse.Namespace) -> int:
    """Rows of the contracts, the unseen robots and the flights."""
    if (args.out / "contract.json").is_file():
        contracts = Store(args.out / "contract.json", ("policy", "kind", "seed"))
        for row in contracts.rows:  # the sentences of right answers would double the file
            row.pop("sentence" if row["right"] else "", None)
        contracts.path = RESULTS / "gap_contract.json"
        contracts.save()
    labels, folders = put_in.labelled(args.shared), sorted((args.out / "put_in").glob("*/*"))
    found = [(f.name, read(Job(f, f))) for f in folders]
    rows = [put_in.scored(name, labels[name][1], answer) for name, answer in found if answer is not None]
    flown = flights.answered(flights.jobs(args.shared, args.out / "flights"))
    for part, rows_of in (("put_in", rows), ("flights", flown)):
        store = Store(RESULTS / f"gap_{part}.json", ("case",))
        store.rows = []
        for row in rows_of:
            store.add({k: v for k, v in row.items() if k not in ("settings", "said", "alike", "equivalent")})
    return 0


def fresh(args: argparse.Namespace, folder: Path) -> list[tuple[Job, bool]]:
    """Cases of a seed that nothing was developed on, and whether their robots walk."""
    draws = list(enumerate(plan(args.cases, args.seed)))
    with ProcessPoolExecutor(args.jobs) as pool:
        for line in pool.map(make_labelled, *zip(*draws, strict=True), [folder] * len(draws)):
            print(line, flush=True)
    labels = read_labels(folder)
    return [(Job(folder / "cases" / n, folder / "out" / n), labels[n]["robot"] in ("g1", "quadruped")) for n in labels]


if __name__ == "__main__":
    raise SystemExit(main())
