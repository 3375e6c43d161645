"""What a log tells about footholds: changes put under a crawling quadruped, and what `realsim footholds` makes of them.

    python -m benchmarks.diagnosis.footholds [--seeds 10 11 ...] [--crossings 10]

One change a case, on terrains that no figure was set on, and terrains without a change. Rows go to
benchmarks/results/footholds.json.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.store import Store
from realsim.gap.case.case import load_case
from realsim.gap.checks.camera.terrain import load_terrain
from realsim.gap.checks.footholds.run import check_scene
from tests.truths.crossings import Truth, make_case

CHANGES = {
    "none": (Truth(), "", ""),
    "lower 2 cm": (Truth(height={"stake_L4": -0.02}), "stake_L4", "height"),
    "higher 2 cm": (Truth(height={"stake_R3": 0.02}), "stake_R3", "height"),
    "tilted 6 deg": (Truth(tilt={"stake_R5": (0.0, 0.105)}), "stake_R5", "tilt"),
    "soft 4 kN/m": (Truth(sinks={"stake_L5": 4000.0}), "stake_L5", "give"),
    "friction 0.12": (Truth(friction={"stake_R4": 0.12}), "stake_R4", "slip"),
    "rocks 45 N m/rad": (Truth(rocks={"stake_L4": 45.0}), "stake_L4", "wobble"),
}


def measure(kind: str, seed: int, crossings: int) -> dict[str, Any]:
    """One case: what was changed, what was named, and the values."""
    truth, place, what = CHANGES[kind]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case = make_case(folder, truth, crossings=crossings, terrain_seed=seed, seed=seed)
        began = time.process_time()
        found = check_scene(load_case(case), load_terrain(folder / "scene.xml")).footholds
        cpu = time.process_time() - began
    named = [[h.name, kind_] for h in found.changed for kind_ in h.changes]
    row: dict[str, Any] = {
        "change": kind, "seed": seed, "crossings": crossings, "named": named, "right": [place, what] in named,
        "false": sum(n != [place, what] for n in named), "contacts": found.contacts, "cpu_s": round(cpu, 1),
    }  # fmt: skip
    hold = next((h for h in found.footholds if h.name == place), None)
    if hold is not None:
        for q in ("height", "tilt_y", "give", "friction", "wobble"):
            if q in hold.quantities:
                v = hold.quantities[q]
                row[q] = [round(v.value, 5), round(v.low, 5), round(v.high, 5)]
    others = [h.quantities["height"].value for h in found.footholds if not h.changes]
    row["rms_of_unnamed_heights_mm"] = round(1000 * float(np.sqrt(np.mean(np.square(others)))), 2)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(10, 15)))
    parser.add_argument("--crossings", type=int, default=10)
    parser.add_argument("--changes", nargs="+", default=list(CHANGES))
    options = parser.parse_args()
    store = Store(Path(__file__).parents[1] / "results" / "footholds.json", ("change", "seed", "crossings"))
    for seed in options.seeds:
        for kind in options.changes:
            try:
                print(store.add(measure(kind, seed, options.crossings)), flush=True)
            except RuntimeError as error:  # the robot fell: no log of a crossing
                print(store.add({"change": kind, "seed": seed, "crossings": options.crossings, "fell": str(error)}))


if __name__ == "__main__":
    main()
