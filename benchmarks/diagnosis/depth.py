"""Does `realsim diagnose` find what is wrong with a depth camera, and nothing where nothing is?

    python benchmarks/diagnosis/depth.py [--cases late nothing] [--crossings 4]
    python benchmarks/diagnosis/depth.py --alone --seeds 300 301 302

A simulated quadruped crawls over stakes and records depth (`tests.truths.crossings`); model.xml has the robot on the
terrain as it was scanned. The whole command runs: motion and camera, with the effects of the motion named here, not all
of the library. With --alone only the camera is judged, on more seeds: how often is the truth inside the interval that
should hold it in 90 of 100? Rows go to benchmarks/results/gap_depth.json.
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
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import realsim as rs
from benchmarks.store import Store
from realsim.gap.case.case import load_case
from realsim.gap.checks.footholds.run import check_camera
from tests.truths.crossings import Truth, make_case

RESULTS = Path(__file__).parents[1] / "results" / "gap_depth.json"
TRUTHS = {
    "late": Truth(camera_delay=0.04),
    "turned": Truth(camera_turn=(0.01745, 0.0, 0.0)),
    "turned2": Truth(camera_turn=(0.0349, 0.0, 0.0)),
    "nothing": Truth(),
}
NAMES = {"late": ["camera_delay"], "turned": ["camera_mount"], "turned2": ["camera_mount"], "nothing": []}
UNITS = np.array([1e3, *[57.29578] * 3, *[1e3] * 3])
QUANTITIES = ("delay_ms", "turn_x_deg", "turn_y_deg", "turn_z_deg", "shift_x_mm", "shift_y_mm", "shift_z_mm")
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


def measure_alone(name: str, seed: int, crossings: int) -> dict[str, Any]:
    """A row of the camera by itself: values with intervals, less the truth."""
    truth = TRUTHS[name]
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        case = make_case(folder, truth, crossings=crossings, terrain_seed=seed, seed=seed, depth=True, cycles=2)
        began = time.process_time()
        camera = check_camera(load_case(case), folder / "scene.xml")
    assert camera is not None
    true = np.array([truth.camera_delay, *truth.camera_turn, *truth.camera_shift])[:, None]
    off = (np.array([camera.delay, *camera.turn, *camera.shift]) - true) * UNITS[:, None]
    return {
        "case": name, "seed": seed, "crossings": crossings, "alone": True, "camera_named": sorted(camera.named),
        **dict(zip(QUANTITIES, np.round(off, 2).tolist(), strict=True)),
        "cpu_seconds": round(time.process_time() - began, 1),
    }  # fmt: skip


def coverage(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Case -> rows, rows that named the camera's effect, and the share of truths inside their intervals."""
    found = {}
    for name in TRUTHS:
        mine = [r for r in rows if r.get("alone") and r["case"] == name]
        if mine:
            inside = {q: sum(r[q][1] <= 0 <= r[q][2] for r in mine) / len(mine) for q in QUANTITIES}
            found[name] = {
                "rows": len(mine), "named": sum(r["camera_named"] == NAMES[name] for r in mine),
                **{q: round(v, 2) for q, v in inside.items()},
            }  # fmt: skip
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=list(TRUTHS), default=list(TRUTHS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[30])
    parser.add_argument("--alone", action="store_true", help="the camera by itself")
    parser.add_argument("--crossings", type=int, default=4)
    parser.add_argument("--store", type=Path, default=RESULTS)
    args = parser.parse_args()
    store = Store(args.store, ("case", "seed", "alone"))
    store.facts = {"effects_considered": [*EFFECTS, "camera_delay", "camera_mount", "depth_noise"]}
    for seed in args.seeds:
        for name in args.cases:
            row = (measure_alone if args.alone else measure)(name, seed, args.crossings)
            print(json.dumps(store.add(row)), flush=True)
            store.facts["coverage_of_90_percent_intervals"] = coverage(store.rows)
            store.save()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
