"""What changed between two logs of one robot: found where it was injected, nothing reported where nothing was.

    python benchmarks/diagnosis/since.py --seed 40 --pairs 20

Draws robots of one or two joints (`tests.truths.diagnosis`) that have one cause at both times, and records them twice
on other commands; in every second pair another cause has come up in between. Counts how often the change is named
(alone, or among changes that fit as well), how often its interval holds the truth, and how often one is named that is
none. Rows of another engine are measured again.
"""

import argparse
import copy
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.diagnosis.score import hit, short
from benchmarks.store import Store
from realsim.core.errors import RealsimError
from realsim.gap import DiagnoseConfig, load_case
from realsim.gap.drift.since import changed_since
from realsim.gap.provenance import engine
from tests.truths.diagnosis import cases, causes
from tests.truths.diagnosis.robots import ROBOTS
from tests.truths.diagnosis.truth import Truth

RESULTS = Path(__file__).parents[1] / "results" / "gap_since.json"
SHARED = ("viscous_friction", "stiffness_gain", "coulomb_friction", "motor_gain", None)
"""Causes at both times, in turn."""
CHANGES = ("coulomb_friction", "payload", "motor_gain", "viscous_friction", "damping_gain", "stiffness_gain")
RUNS = 4


def record(seed: int, index: int, work: Path) -> tuple[str, list[dict[str, Any]], list[dict[str, Any]]]:
    """(robot, causes at both times, change); the two cases are written to `work`."""
    rng = np.random.default_rng([seed, index])
    robot = ROBOTS[("pendulum", "arm2")[index // 2 % 2]](rng)
    sensors = cases._sensors(robot, "single", rng)
    site = cases.site_of(robot, mujoco.MjModel.from_xml_string(robot.xml), seed * 1000 + index)
    truth = Truth(len(robot.joints))
    cases._nuisances(truth, site, rng)
    known = causes.available(robot)
    shared, change = SHARED[index // 2 % len(SHARED)], CHANGES[index // 2 % len(CHANGES)]
    both = [known[shared](truth, site, rng, 0.6)] if shared and shared != change else []
    later = copy.deepcopy(truth)
    changed = [known[change](later, site, rng, float(rng.uniform(0.4, 1.0)))] if index % 2 else []
    for name, here in (("before", truth), ("today", later)):
        commands = cases._commands(robot, sensors, RUNS, rng)
        traces = cases._drive(robot, here, commands)
        assert traces is not None
        cases.write_log(work / name, robot, sensors, here, commands, traces, rng)
    return robot.name, both, changed


def one_pair(seed: int, index: int) -> dict[str, Any]:
    """A row."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as work:
        robot, both, changed = record(seed, index, Path(work))
        row = {"seed": seed, "pair": index, "engine": engine(), "robot": robot, "both": [short(c) for c in both],
               "truth": [short(c) for c in changed]}  # fmt: skip
        try:
            today, before = (load_case(Path(work) / name) for name in ("today", "before"))
            found = changed_since(today, before, DiagnoseConfig(threads=1)).as_dict()
        except RealsimError as error:
            return row | {"verdict": "refused", "said": error.message}
    sets = [found["changes"], *found["equivalent"]]
    row |= {"verdict": found["verdict"], "sets": [[short(c) for c in s] for s in sets]}
    if changed:
        row["alone"] = found["verdict"] == "identified" and len(sets[0]) == 1 and hit(sets[0][0], changed[0])
        row["named"] = any(hit(c, changed[0]) for s in sets for c in s)
        row["ci90_holds"] = _holds(sets, changed[0])
    return row | {"cpu_seconds": round(time.process_time() - began, 1)}


def _holds(sets: list[Any], truth: dict[str, Any]) -> bool | None:
    """Whether the interval of the change holds the truth; None where it is not named."""
    value = truth["parameters"][0]["value"]
    for s in sets:
        for cause in s:
            if hit(cause, truth):
                ends = next(iter(cause["parameters"].values()))["ci90"]
                return None if ends is None else bool(ends[0] <= value <= ends[1])
    return None


def table(rows: list[dict[str, Any]]) -> str:
    """All rows and their sums."""
    lines = [
        f"{r['pair']:3} {r['robot']:8} both {','.join(r['both']) or '-':26} change {','.join(r['truth']) or '-':26} -> "
        f"{r['verdict']} {r.get('sets', '')}"
        for r in rows
    ]
    with_change, without = [r for r in rows if r["truth"]], [r for r in rows if not r["truth"]]
    held = [r["ci90_holds"] for r in with_change if r.get("ci90_holds") is not None]
    lines.append(f"change named alone {sum(r.get('alone', False) for r in with_change)}/{len(with_change)}, "
                 f"named {sum(r.get('named', False) for r in with_change)}/{len(with_change)}, "
                 f"intervals that hold it {sum(held)}/{len(held)}")  # fmt: skip
    lines.append(
        f"a change named where there is none {sum(r['verdict'] != 'unchanged' for r in without)}/{len(without)}"
    )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--only", nargs="*", type=int, help="of these, the pairs to measure now; all if not given")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--robots", nargs="*", default=["pendulum", "arm2"])
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    store, began = Store(args.store, ("seed", "pair")), time.monotonic()
    done = {r["pair"] for r in store.rows if r["seed"] == args.seed and r.get("engine") == engine()}
    for index in args.only or range(args.pairs):
        wanted = ("pendulum", "arm2")[index // 2 % 2] in args.robots
        if index not in done and wanted and time.monotonic() - began < 60 * args.minutes:
            print(json.dumps(store.add(one_pair(args.seed, index))), flush=True)
    print(table([r for r in store.rows if r["seed"] == args.seed]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
