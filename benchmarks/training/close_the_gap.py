"""What closing the loop regains: `benchmarks/training/closed_loop.py`, kept as rows.

    python benchmarks/training/close_the_gap.py --out loop [options of closed_loop.py]

Runs that script, or goes on with it, and stores a row for every robot that it has finished in
benchmarks/results/close_the_gap.json. With `--store-only` it stores what is there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.store import Store

LOOP = Path(__file__).with_name("closed_loop.py")
RESULTS = Path(__file__).parents[1] / "results" / "close_the_gap.json"
KEY = ("robot", "iterations", "effects_considered", "course")
FACTS = {
    "what": "A simulated robot that its model does not describe: success on the way (4 m on flat ground in 10 s, "
    "or a course) before, after fine-tuning with the diagnosis, and after the same fine-tuning with randomisation "
    "alone. One seed.",
}


def rows(results: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each robot of which all is there."""
    found = []
    for name in dict.fromkeys(key.partition("/")[0] for key in results if "/" in key):
        parts = {k: results.get(f"{name}/{k}") for k in ("before", "diagnosis", "patch", "random")}
        if "nominal" not in results or None in parts.values():
            continue
        before, nominal, options = parts["before"], results["nominal"], results["options"]
        robot = " ".join([*[options[k] for k in ("robot",) if k in options], name])
        row: dict[str, Any] = {"robot": robot, "truth": before["what"], "iterations": options["iterations"]}
        row |= {"effects_considered": ", ".join(parts["diagnosis"].get("effects_considered") or ["all"])}
        row |= {"course": options["course"]}
        row |= {"verdict": parts["diagnosis"]["verdict"], "causes": parts["diagnosis"]["causes"]}
        row |= {"nominal": _short(nominal), "before": _short(before)}
        for arm in ("patch", "random"):
            row[arm] = _short(parts[arm])
            row[f"regained_{arm}"] = {what: _regained(nominal, before, parts[arm], what) for what in ("rate", "speed")}
        row["cpu_seconds"] = {k: v["cpu_seconds"] for k, v in results.items() if k.startswith(f"{name}/")}
        found.append(row)
    return found


def _regained(nominal: dict[str, Any], before: dict[str, Any], after: dict[str, Any], what: str) -> float | None:
    """Share of what was lost; None where nothing was."""
    lost = nominal[what] - before[what]
    return round((after[what] - before[what]) / lost, 3) if lost > 0 else None


def _short(trials: dict[str, Any]) -> dict[str, Any]:
    kept = {k: trials[k] for k in ("rate", "speed", "trials", "reasons", "seconds", "covered")}
    return kept | {"interval": [round(v, 4) for v in trials["interval"]]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("loop"))
    parser.add_argument("--store-only", action="store_true")
    parser.add_argument("--store", type=Path, default=RESULTS)
    args, rest = parser.parse_known_args()
    if not args.store_only:
        subprocess.run([sys.executable, str(LOOP), "--out", str(args.out), *rest], check=True)
    store = Store(args.store, KEY)
    store.facts = FACTS
    for row in rows(json.loads((args.out / "results.json").read_text())):
        print(json.dumps(store.add(row)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
