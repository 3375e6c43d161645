"""Labelled cases of robots that the diagnosis was not developed on, a line a case.

    python benchmarks/diagnosis/put_in.py --jobs 2                     # all; needs the cases (shared)
    python benchmarks/diagnosis/put_in.py --only servo_01 dp_C1_00     # some of them

Cases with an error put into the model of a real robot (real_logs/errors_put_in), and logs that once got a wrong answer
(cases/logs). What this engine has answered is not diagnosed again; every engine has a folder of its own below --work,
so that two of them can be compared pair by pair, and several processes share one.
"""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.pool import Job, diagnose_all, read
from benchmarks.diagnosis.real import NAMES, accepted_sets, row
from benchmarks.diagnosis.score import hit, short
from benchmarks.store import Store
from realsim.gap.provenance import engine

Row = dict[str, Any]


def _cause(effect: str, *joints: str, body: str = "") -> Row:
    return {"effect": effect, "joints": list(joints) or None, "bodies": [body] if body else None}


_LATE = [_cause("observation_delay")]
LOGS = {
    "servo_01": ([_cause("coulomb_friction", "servo")], [[]]),
    "servo_01_init": ([_cause("coulomb_friction", "servo")], [[]]),
    "servo_01_hold": ([_cause("coulomb_friction", "servo")], [[]]),
    "servo_03": ([_cause("command_delay")], [_LATE]),
    "ur_j3_01": ([_cause("coulomb_friction", "joint3")], [[]]),
    "P1_z1_friction": ([_cause("coulomb_friction", "j0", "j1"), _cause("viscous_friction", "j0", "j1")], [[], []]),
    "P7_ros2demos551_late_1s": ([_cause("command_delay")], [_LATE]),
    "cf_W3_M3": ([_cause("payload", body="cf2")], [[]]),
}
"""Case of cases/logs -> (its causes, what changes the motion as each does), from the README there."""


def main() -> int:
    parser = options(__doc__, "out/gap_put_in")
    parser.add_argument("--shared", type=Path, default=Path(os.environ.get("REALSIM_SHARED", "../shared")))
    args = parser.parse_args()
    cases = {n: c for n, c in labelled(args.shared).items() if not args.only or n in args.only}
    if not cases:
        print(f"{args.shared} holds none of the cases: --shared says where they lie", file=sys.stderr)
        return 2
    jobs = {n: Job(folder, args.work / engine() / n) for n, (folder, _) in cases.items()}
    store = Store(args.store or args.work / "rows.json", ("case", "engine", "settings"))
    answer_all(args, jobs, {n: label for n, (_, label) in cases.items()}, store)
    return 0


def options(about: str | None, work: str) -> argparse.ArgumentParser:
    """What every benchmark of labelled cases takes."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", help="only these cases")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this many minutes")
    parser.add_argument("--work", type=Path, default=Path(work))
    parser.add_argument("--store", type=Path, help="rows (default: rows.json in --work)")
    return parser


def answer_all(
    args: argparse.Namespace,
    jobs: Mapping[str, Job],
    labels: Mapping[str, Row],
    store: Store,
    kept: Callable[[str, Row], Row] = lambda name, row: row,
) -> None:
    """Diagnose what is not answered yet, print and store a line a case (as `kept` changes its row), and count them."""
    diagnose_all(list(jobs.values()), args.jobs, args.minutes)
    rows = []
    for name, job in jobs.items():
        if (answer := read(job)) is not None:
            row = scored(name, labels[name], answer)
            changed = kept(name, row)
            print(line(row | changed))
            rows.append(store.add(changed))
    count = Counter(r["judged"] for r in rows if r["judged"] != "not visible")
    print(f"engine {engine()}, {len(rows)} cases: " + ", ".join(f"{n} {what}" for what, n in count.most_common()))


def labelled(shared: Path) -> dict[str, tuple[Path, Row]]:
    """Case -> (its folder, its label)."""
    found: dict[str, tuple[Path, Row]] = {}
    put_in = shared / "real_logs" / "errors_put_in"
    if (put_in / "labels.json").is_file():
        for name, label in json.loads((put_in / "labels.json").read_text()).items():
            found[name] = put_in / name, label | {"log": label["robot"], "part": "put_in"}
    for name, (effects, alike) in LOGS.items():
        if (folder := shared / "cases" / "logs" / name).is_dir():
            cls = "single" if len(effects) == 1 else "double"
            label = {"effects": effects, "alike": alike, "visibility": [], "cls": cls, "visible": True}
            found[name] = folder, label | {"log": name, "part": "logs"}
    return found


def scored(name: str, label: Row, answer: Row) -> Row:
    """The row of a case."""
    return row(name, label, answer) | {"judged": judged(label, answer), "sizes": sizes(answer)}


def judged(label: Row, answer: Row) -> str:
    """What an answer is worth, in two or three words."""
    causes, verdict = answer["causes"], answer["verdict"]
    accepted = [t for s in accepted_sets(label) for t in s]
    if not label["effects"]:
        return "nothing put in, named" if causes and verdict in NAMES else "nothing put in, not named"
    if not label["visible"]:
        return "not visible"
    if not causes:
        return f"silent ({verdict})"
    if any(hit(causes[0], t) for t in label["effects"]):
        return "first right" if verdict in NAMES else "right, unexplained"
    if any(hit(causes[0], t) for t in accepted):
        return "equivalent" if verdict in NAMES else "equivalent, unexplained"
    if any(hit(c, t) for s in (causes, *answer["equivalent"]) for c in s for t in accepted):
        return "among the named" if verdict in NAMES else "among the nearest"
    return "SURE AND WRONG" if verdict == "identified" else "wrong" if verdict in NAMES else "wrong, unexplained"


def sizes(answer: Row) -> list[str]:
    """Every cause with its values."""
    found = []
    for c in answer["causes"]:
        values = " ".join(
            f"{n}={p.get('value', p.get('now')):.3g}" + ("[{:.3g},{:.3g}]".format(*p["ci90"]) if p.get("ci90") else "")
            for n, p in c["parameters"].items()
        )
        found.append(f"{short(c)} {values}")
    return found


def line(found: Row) -> str:
    others = " | ".join("+".join(s) for s in found["equivalent"][:3])
    return (
        f"{found['case']:<24} {found['judged']:<26} {found['verdict']:<17} truth {'+'.join(found['truth']) or '-'}"
        f"  found {'; '.join(found['sizes']) or '-'}" + (f"  or {others}" if others else "")
        + f"  {found['cpu_seconds'] or 0:.0f} s"
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
