"""Does `realsim diagnose` find what is wrong with a depth camera, and nothing where nothing is?

    python benchmarks/gap_depth.py [--cases late nothing] [--crossings 4]

A simulated quadruped crawls over stakes and records depth (`benchmarks.crossings`); model.xml has the robot on the
terrain as it was scanned. The whole command runs: motion and camera, with the effects of the motion named here, not all
of the library. Rows go to benchmarks/results/gap_depth.json.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import realsim as rs
from benchmarks.crossings import Truth, make_case
from benchmarks.store import Store

RESULTS = Path(__file__).parent / "results" / "gap_depth.json"
TRUTHS = {
    "late": Truth(camera_delay=0.04),
    "turned": Truth(camera_turn=(0.01745, 0.0, 0.0)),
    "nothing": Truth(),
}
EFFECTS = ("command_delay", "payload", "motor_gain", "ground_friction")


def on_terrain(case: Path, scene: Path) -> None:
    """Put the scanned stakes into the case's model."""
    spec, terrain = mujoco.MjSpec.from_file(str(case / "model.xml")), mujoco.MjSpec.from_file(str(scene))
    for geom in terrain.worldbody.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            spec.worldbody.add_geom(
                name=geom.name, type=geom.type, pos=geom.pos, size=geom.size, friction=geom.friction
            )
    spec.compile()
    (case / "model.xml").write_text(spec.to_xml())


def measure(name: str, seed: int, crossings: int) -> dict[str, Any]:
    """A row."""
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        case = make_case(folder, TRUTHS[name], crossings=crossings, terrain_seed=seed, seed=seed, depth=True, cycles=2)
        on_terrain(case, folder / "scene.xml")
        began = time.process_time()
        found = rs.diagnose(case, folder / "out", rs.DiagnoseConfig(effects=EFFECTS, threads=1))
        page = (folder / "out" / "report.html").is_file()
    camera = found.data["statistics"]["camera"]
    return {
        "case": name, "seed": seed, "crossings": crossings, "verdict": str(found.verdict),
        "causes": [str(c) for c in found.causes], "camera_named": sorted(camera["named"]),
        "delay_ms": [round(1e3 * v, 1) for v in camera["delay_s"]],
        "turn_deg": [[round(57.29578 * v, 2) for v in axis] for axis in camera["turn_rad"]],
        "report": page, "cpu_seconds": round(time.process_time() - began, 1),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=list(TRUTHS), default=list(TRUTHS))
    parser.add_argument("--seed", type=int, default=30)
    parser.add_argument("--crossings", type=int, default=4)
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    store = Store(args.store, ("case", "seed"))
    store.facts = {"effects_considered": [*EFFECTS, "camera_delay", "camera_mount", "depth_noise"]}
    for name in args.cases:
        print(json.dumps(store.add(measure(name, args.seed, args.crossings))), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
